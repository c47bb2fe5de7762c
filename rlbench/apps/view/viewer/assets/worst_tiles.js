// The tiles of a clip where a method errs most.

import { h, short } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { srgb } from "viewer/tone.js";
import { clip, picture } from "viewer/workspace.js";

export const TILE = 16; // pixels
const WORST = 8; // tiles that are listed

const found = new Map(); // worst tiles by clip, budget and method

/** List the worst tiles of method A; a click shows one. */
export async function listWorst(list) {
  const { a } = state;
  const key = [state.clip, state.spp, a].join("|");
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  if (!found.has(key)) found.set(key, await worstTiles(a));
  if (list.dataset.key !== key) return;
  list.replaceChildren(
    ...found.get(key).map(({ frame, x, y, error }) =>
      h(
        "li",
        {},
        h(
          "button",
          {
            type: "button",
            onclick: () => set({ frame, x: x + TILE / 2, y: y + TILE / 2, zoom: 12, px: x, py: y }),
          },
          `frame ${frame}, x ${x}, y ${y}: ${short(-10 * Math.log10(Math.max(error, 1e-12)))} dB`,
        ),
      ),
    ),
  );
}

/** The tiles with the largest squared error in clipped sRGB. */
async function worstTiles(method) {
  const { width, height, frames } = clip();
  const tiles = [];
  for (let frame = 0; frame < frames; frame++) {
    const [image, reference] = await Promise.all([
      picture(method, "image", frame),
      picture("reference", "image", frame),
    ]);
    for (let y = 0; y < height; y += TILE) {
      for (let x = 0; x < width; x += TILE)
        tiles.push({ frame, x, y, error: tileError(image, reference, x, y) });
    }
  }
  return tiles.sort((one, other) => other.error - one.error).slice(0, WORST);
}

function tileError(image, reference, x0, y0) {
  let [sum, count] = [0, 0];
  for (let y = y0; y < Math.min(y0 + TILE, image.height); y++) {
    for (let x = x0; x < Math.min(x0 + TILE, image.width); x++) {
      const i = y * image.width + x;
      for (let c = 0; c < 3; c++) {
        sum += (srgb(image.planes[c][i] || 0) - srgb(reference.planes[c][i])) ** 2;
        count++;
      }
    }
  }
  return sum / count;
}
