// The pictures of Decide: winner, runner-up and reference where the two differ most.

import { h, short } from "viewer/dom.js";
import { set } from "viewer/state.js";
import { clips } from "viewer/pictures.js";
import { srgb } from "viewer/tone.js";

const SIDE = 64; // of the region, pixels of the image
const STEP = 16; // between two places that are compared

/** Fill `element` with the crops of the first two of `ranked`, of a clip of the scene if it has one. */
export async function crops(element, ranked, scene) {
  const shown = choose(ranked, scene);
  const key = shown ? [shown.index, shown.spp, shown.a, shown.b].join("|") : "";
  if (element.dataset.key === key) return;
  element.dataset.key = key;
  if (!shown) {
    const reason = clips.length ? "no image of the first two" : "no images: rlbench run --keep-images";
    element.replaceChildren(...(ranked.length ? [h("p", { class: "hint" }, `The page has ${reason}.`)] : []));
    return;
  }
  const { index, clip, spp, a, b } = shown;
  const frame = clip.frames - 1;
  const images = await Promise.all(
    [a, b, "reference"].map((source) => clip.picture(source, spp, frame)),
  );
  if (element.dataset.key !== key) return; // another answer by now
  const region = mostDifferent(images[0], images[1]);
  const centre = { x: region.x + region.side / 2, y: region.y + region.side / 2 };
  const names = [`${a}, the winner`, `${b}, the runner-up`, "reference"];
  const open = () => set({ view: "flip", clip: index, spp, a, b, show: "a", frame, zoom: 6, ...centre });
  element.replaceChildren(
    h(
      "p",
      {},
      `${clip.name} at ${short(spp)} spp, frame ${frame}, where the two differ most. `,
      h("button", { type: "button", "data-open": "flip", onclick: open }, "Compare them in Flip"),
    ),
    h(
      "div",
      { class: "crop-row" },
      images.map((image, i) =>
        h("figure", {}, paint(image, region), h("figcaption", {}, names[i])),
      ),
    ),
  );
}

/** Clip, budget and methods of the crops; null where the page has no images of both methods. */
function choose(ranked, scene) {
  const [first, second] = ranked;
  if (!second) return null;
  const all = clips.map((read, index) => ({ clip: read(), index }));
  const order = [...all.filter((each) => each.clip.scene === scene), ...all];
  for (const { clip, index } of order) {
    const budgets = clip.budgets.filter((spp) => {
      const names = clip.methods(spp);
      return names.includes(first.method) && names.includes(second.method);
    });
    if (!budgets.length) continue;
    const ratio = (spp) => Math.abs(Math.log(spp / first.spp));
    const spp = budgets.reduce((one, other) => (ratio(other) < ratio(one) ? other : one));
    return { clip, index, spp, a: first.method, b: second.method };
  }
  return null;
}

/** The square region with the largest squared difference in clipped sRGB. */
function mostDifferent(one, other) {
  const { width, height } = one;
  const side = Math.min(SIDE, width, height);
  let best = { x: 0, y: 0, side, error: -1 };
  for (let y = 0; y + side <= height; y += STEP) {
    for (let x = 0; x + side <= width; x += STEP) {
      let error = 0;
      for (let j = y; j < y + side; j += 2) {
        for (let i = x; i < x + side; i += 2) {
          const at = j * width + i;
          for (let c = 0; c < 3; c++)
            error += (srgb(one.planes[c][at] || 0) - srgb(other.planes[c][at] || 0)) ** 2;
        }
      }
      if (error > best.error) best = { x, y, side, error };
    }
  }
  return best;
}

/** A canvas with the pixels of a region. */
function paint(image, { x, y, side }) {
  const canvas = h("canvas", { width: side, height: side });
  const pixels = new ImageData(side, side);
  for (let j = 0; j < side; j++) {
    for (let i = 0; i < side; i++) {
      const at = (y + j) * image.width + x + i;
      for (let c = 0; c < 3; c++)
        pixels.data[4 * (j * side + i) + c] = 255 * srgb(image.planes[c][at] || 0);
      pixels.data[4 * (j * side + i) + 3] = 255;
    }
  }
  canvas.getContext("2d").putImageData(pixels, 0, 0);
  return canvas;
}
