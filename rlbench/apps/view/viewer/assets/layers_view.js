// Layers: one layer of all methods on one scale of colours.

import { h, select, short, slider } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { data, isGallery, maps } from "viewer/data.js";
import { BUFFERS } from "viewer/pictures.js";
import { clip, methods, picture, sources, truth } from "viewer/workspace.js";

export const gesture = "pan";

const OUTSIDE = 512; // motion of more pixels points outside: there is no history

const ERROR = isGallery ? "difference" : "error";

/** Layer: [name, meaning of its scale, colour map]; TRUTH: what images are compared with. */
const LAYERS = {
  image: ["image"],
  signed: [`signed ${ERROR}`, "image minus TRUTH in clipped sRGB, mean over channels", "signed"],
  squared: [
    `squared ${ERROR}`,
    "squared difference to TRUTH in clipped sRGB, mean over channels",
    "error",
  ],
  flip: [
    "FLIP",
    "FLIP to TRUTH, of clipped sRGB at 67 pixels per degree (Andersson et al. 2020)",
    "error",
  ],
  counts: ["samples", "samples per pixel", "counts"],
  albedo: ["albedo"],
  normal: ["normal"],
  depth: ["depth", "distance, logarithmic; background grey", "depth"],
  motion: ["motion", "length of the motion vector, pixels; the brightest has no history", "counts"],
};

export function extras() {
  const layer = select(
    "layer",
    () => present().map((name) => [name, LAYERS[name][0]]),
    chosenLayer,
    (value) => set({ layer: value }),
  );
  const compared = select(
    "compared with",
    () => methods().map((name) => [name, name]),
    () => state.a,
    (a) => set({ a }),
  );
  const scale = slider(
    `end of the ${ERROR} scale`,
    { min: -7, max: 0, step: 0.5 },
    () => Math.log2(state.range),
    (power) => set({ range: 2 ** power }),
    (power) => short(2 ** power, 2),
  );
  const bar = h("canvas", { width: 256, height: 1, class: "colour-bar" });
  const [low, high, meaning] = [h("span"), h("span"), h("span", { class: "hint" })];
  const legend = h("div", { class: "legend" }, low, bar, high, meaning);
  const update = async () => {
    [layer, scale, compared].forEach((each) => each.update());
    const now = chosenLayer();
    scale.element.hidden = !["signed", "squared"].includes(now);
    compared.element.hidden = !isGallery || now === "image";
    const [, text, map] = LAYERS[now];
    legend.hidden = !text;
    if (!text) return;
    meaning.textContent = text.replace("TRUTH", truth);
    paint(bar, maps[data.map_of[map]]);
    const [from, to] = await rangeOf(now);
    const shown = now === "depth" ? [2 ** from, 2 ** to] : [from, to];
    [low.textContent, high.textContent] = shown.map((value) => short(value, 2));
  };
  const controls = [layer, compared, scale].map((each) => each.element);
  return { element: h("div", { class: "toolbar" }, controls, legend), update };
}

/** The layers that the page has: a single image file is compared with nothing. */
function present() {
  const own = clip().buffersPresent;
  const compared = methods().length > 1 ? ["signed", "squared", "flip"] : [];
  return Object.keys(LAYERS).filter((name) =>
    isGallery
      ? ["image", ...compared].includes(name)
      : !BUFFERS.includes(name) || own.includes(name),
  );
}

/** The layer of the state, or the image where the page does not have it. */
export function chosenLayer() {
  return present().includes(state.layer) ? state.layer : "image";
}

export function panes() {
  const layer = chosenLayer();
  const map = data.map_of[LAYERS[layer][2] ?? "error"];
  const shader = layer === "flip" || layer === "counts" ? "scalar" : layer;
  const look = {
    layer: shader,
    curve: state.curve,
    ev: state.ev,
    map,
    split: -1,
    range: ranges.get(rangeKey(layer)) ?? [0, 1],
  };
  if (BUFFERS.includes(layer)) return [{ label: LAYERS[layer][0], image: picture(layer), look }];
  if (layer === "image")
    return sources().map((name) => ({ label: name, image: picture(name), look }));
  const kind = layer === "flip" || layer === "counts" ? layer : "image";
  const base = truth();
  return methods()
    .filter((name) => name !== base)
    .map((name) => ({
      label: name,
      image: picture(name, kind),
      reference: picture(base),
      look,
    }));
}

const ranges = new Map();
const rangeKey = (layer) => [layer, state.clip, state.spp, state.frame, state.range].join("|");

/** Both ends of the scale, for all methods; `ready` is called when they are first known. */
export async function rangeOf(layer, ready = () => {}) {
  const key = rangeKey(layer);
  if (!ranges.has(key)) {
    ranges.set(key, await measure(layer));
    ready();
  }
  return ranges.get(key);
}

async function measure(layer) {
  if (layer === "signed") return [-state.range, state.range];
  if (layer === "squared") return [0, state.range ** 2];
  if (layer === "flip") return [0, 1];
  if (layer === "counts") {
    const images = await Promise.all(methods().map((name) => picture(name, "counts")));
    return [0, Math.max(1, ...images.map((image) => largest(image.planes[0], Infinity)))];
  }
  if (layer === "depth") {
    const depths = (await picture("depth")).planes[0].filter(
      (value) => Number.isFinite(value) && value > 0,
    );
    return [Math.log2(smallest(depths)), Math.log2(largest(depths, Infinity)) + 1e-3];
  }
  if (layer === "motion") {
    const [x, y] = (await picture("motion")).planes;
    return [
      0,
      Math.max(
        1,
        largest(
          x.map((value, i) => Math.hypot(value, y[i])),
          OUTSIDE,
        ),
      ),
    ];
  }
  return [0, 1];
}

function largest(values, limit) {
  return values.reduce((most, value) => (value > most && value < limit ? value : most), 0);
}

function smallest(values) {
  return values.reduce((least, value) => Math.min(least, value), Infinity);
}

function paint(canvas, colours) {
  const context = canvas.getContext("2d");
  const image = context.createImageData(256, 1);
  for (let i = 0; i < 256; i++) image.data.set([...colours.subarray(3 * i, 3 * i + 3), 255], 4 * i);
  context.putImageData(image, 0, 0);
}
