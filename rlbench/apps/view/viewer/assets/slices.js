// Slices through time: the pixels on a line, frame below frame.

import { h } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { tone } from "viewer/tone.js";
import { clip, picture, sources } from "viewer/workspace.js";

/** The line of the slice; by default the middle row. */
export function sliceLine() {
  const { width, height } = clip();
  return state.line ? state.line.split(",").map(Number) : [0, height >> 1, width - 1, height >> 1];
}

/** Draw the slices of the reference and of all methods into an element. */
export async function drawSlices(element) {
  const now = clip();
  const [x0, y0, x1, y1] = sliceLine();
  const length = Math.max(Math.abs(x1 - x0), Math.abs(y1 - y0)) + 1;
  const along = Array.from({ length }, (_, i) => {
    const share = length > 1 ? i / (length - 1) : 0;
    return Math.round(y0 + share * (y1 - y0)) * now.width + Math.round(x0 + share * (x1 - x0));
  });
  const key = [state.clip, state.spp, state.line, state.ev, state.curve].join("|");
  if (element.dataset.key === key) return;
  element.dataset.key = key;
  const figures = await Promise.all(
    sources().map(async (name) => {
      const frames = await Promise.all(
        Array.from({ length: now.frames }, (_, frame) => picture(name, "image", frame)),
      );
      const canvas = h("canvas", {
        width: length,
        height: now.frames,
        "data-slice": name,
        role: "img",
        "aria-label": `slice of ${name}`,
        onclick: (event) =>
          set({
            frame: Math.min(
              now.frames - 1,
              Math.floor((event.offsetY / canvas.clientHeight) * now.frames),
            ),
          }),
      });
      const image = canvas.getContext("2d").createImageData(length, now.frames);
      frames.forEach(({ planes }, frame) =>
        along.forEach((pixel, i) => {
          const values = planes.map((plane) => plane[pixel]);
          const colour = values.every(Number.isFinite)
            ? values.map((value) => 255 * tone(value, state.ev, state.curve))
            : [255, 0, 255];
          image.data.set([...colour, 255], 4 * (frame * length + i));
        }),
      );
      canvas.getContext("2d").putImageData(image, 0, 0);
      return h("figure", {}, h("figcaption", {}, name), canvas);
    }),
  );
  if (element.dataset.key === key) element.replaceChildren(...figures);
}
