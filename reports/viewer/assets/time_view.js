// Time: scores of frames, slices through time, and the worst tiles of method A.

import { h, s, select, short } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { data } from "viewer/data.js";
import { look as lookOf } from "viewer/colours.js";
import { chart, path, span } from "viewer/chart.js";
import { srgb, tone } from "viewer/tone.js";
import { clip, methods, picture } from "viewer/workspace.js";

export const gesture = "line";

const TILE = 16; // pixels
const WORST = 8; // tiles that are listed

export function panes() {
  const look = { layer: "image", curve: state.curve, ev: state.ev, range: [0, 1], map: "magma", split: -1 };
  return [state.a, "reference"].map((name) => ({ label: name, image: picture(name), look }));
}

/** The line of the slice; by default the middle row. */
export function sliceLine() {
  const { width, height } = clip();
  return state.line ? state.line.split(",").map(Number) : [0, height >> 1, width - 1, height >> 1];
}

export function extras() {
  const metric = select("score", () => metricsOf().map((name) => [name, name]), chosenMetric, (value) => set({ metric: value }));
  const method = select("method A", () => methods().map((name) => [name, name]), () => state.a, (a) => set({ a }));
  const curves = h("div", { class: "plot" });
  const slices = h("div", { class: "slices" });
  const worst = h("ol", { class: "worst" });
  const element = h("div", {},
    h("div", { class: "toolbar" }, method.element, metric.element), curves,
    h("h3", {}, "Slice through time ", h("small", {}, "drag a line on the image; time runs down; click to jump to a frame")), slices,
    h("h3", {}, "Worst tiles of method A ", h("small", {}, `${TILE} x ${TILE} pixels, all frames`)), worst);
  const update = () => {
    metric.update();
    method.update();
    curves.replaceChildren(scoreChart());
    drawSlices(slices);
    listWorst(worst);
  };
  return { element, update };
}

const metricsOf = () => [...new Set(data.frames.filter((each) => each.clip === clip().name).map((each) => each.metric))];
const chosenMetric = () => (metricsOf().includes(state.metric) ? state.metric : metricsOf()[0]);

function scoreChart() {
  const names = methods();
  const shown = data.frames.filter((each) => each.clip === clip().name && each.spp === state.spp && each.metric === chosenMetric() && names.includes(each.method));
  if (!shown.length) return h("p", { class: "hint" }, "no scores of frames");
  shown.sort((one, other) => names.indexOf(one.method) - names.indexOf(other.method));
  const unit = data.devices.flatMap((d) => d.table.metrics).find((m) => m.metric === chosenMetric())?.unit;
  const [from, to] = span(shown.flatMap((each) => each.values.filter((value) => value !== null)));
  const width = Math.min(900, document.documentElement.clientWidth - 32);
  const last = Math.max(1, clip().frames - 1);
  const { svg, plot, px, py, box } = chart({ width, height: 260, label: `${chosenMetric()} of each frame`,
    x: { from: -0.2, to: last + 0.2, label: "frame; dotted: cut", whole: true }, y: { from, to, label: unit ? `${chosenMetric()} [${unit}]` : chosenMetric() } });
  plot.append(...clip().cuts.map((cut) => s("line", { class: "cut", x1: px(cut - 0.5), x2: px(cut - 0.5), y1: box.top, y2: box.bottom })));
  plot.append(s("line", { class: "now", x1: px(state.frame), x2: px(state.frame), y1: box.top, y2: box.bottom }));
  for (const each of shown) {
    const { colour, dash } = lookOf(each.method);
    const points = each.values.map((value, frame) => [px(frame), value === null ? NaN : py(value)]);
    plot.append(s("path", { d: path(points), stroke: colour, "stroke-dasharray": dash, class: each.method === state.a ? "curve is-a" : "curve" }, s("title", {}, each.method)));
    plot.append(...points.filter(([, y]) => Number.isFinite(y)).map(([cx, cy]) => s("circle", { cx, cy, r: 2.5, fill: colour })));
  }
  svg.addEventListener("click", (event) => {
    const box = svg.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * width;
    const frame = Math.round(((x - px(0)) / (px(1) - px(0))));
    set({ frame: Math.min(Math.max(frame, 0), clip().frames - 1) });
  });
  svg.dataset.px0 = px(0);
  svg.dataset.px1 = px(1);
  return h("div", {}, svg, legend(shown.map((each) => each.method)));
}

/** Names of methods beside their lines. */
export function legend(names) {
  return h("ul", { class: "legend-list" }, names.map((name) => {
    const { colour, dash } = lookOf(name);
    return h("li", {}, s("svg", { width: 26, height: 10 }, s("line", { x1: 1, x2: 25, y1: 5, y2: 5, stroke: colour, "stroke-dasharray": dash, "stroke-width": 2.5 })), ` ${name}`);
  }));
}

async function drawSlices(element) {
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
  const figures = await Promise.all(["reference", ...methods()].map(async (name) => {
    const frames = await Promise.all(Array.from({ length: now.frames }, (_, frame) => picture(name, "image", frame)));
    const canvas = h("canvas", { width: length, height: now.frames, "data-slice": name, role: "img", "aria-label": `slice of ${name}`,
      onclick: (event) => set({ frame: Math.min(now.frames - 1, Math.floor((event.offsetY / canvas.clientHeight) * now.frames)) }) });
    const image = canvas.getContext("2d").createImageData(length, now.frames);
    frames.forEach(({ planes }, frame) => along.forEach((pixel, i) => {
      const values = planes.map((plane) => plane[pixel]);
      const colour = values.every(Number.isFinite) ? values.map((value) => 255 * tone(value, state.ev, state.curve)) : [255, 0, 255];
      image.data.set([...colour, 255], 4 * (frame * length + i));
    }));
    canvas.getContext("2d").putImageData(image, 0, 0);
    return h("figure", {}, h("figcaption", {}, name), canvas);
  }));
  if (element.dataset.key === key) element.replaceChildren(...figures);
}

const found = new Map(); // worst tiles by clip, budget and method

async function listWorst(list) {
  const { a } = state;
  const key = [state.clip, state.spp, a].join("|");
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  if (!found.has(key)) found.set(key, await worstTiles(a));
  if (list.dataset.key !== key) return;
  list.replaceChildren(...found.get(key).map(({ frame, x, y, error }) => h("li", {}, h("button", { type: "button",
    onclick: () => set({ frame, x: x + TILE / 2, y: y + TILE / 2, zoom: 12, px: x, py: y }) },
    `frame ${frame}, x ${x}, y ${y}: ${short(-10 * Math.log10(Math.max(error, 1e-12)))} dB`))));
}

/** The tiles with the largest squared error in clipped sRGB. */
export async function worstTiles(method) {
  const { width, height, frames } = clip();
  const tiles = [];
  for (let frame = 0; frame < frames; frame++) {
    const [image, reference] = await Promise.all([picture(method, "image", frame), picture("reference", "image", frame)]);
    for (let y = 0; y < height; y += TILE) {
      for (let x = 0; x < width; x += TILE) tiles.push({ frame, x, y, error: tileError(image, reference, x, y) });
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
