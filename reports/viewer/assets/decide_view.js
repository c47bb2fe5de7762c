// Decide: which method gives the least error at a cost of a sample and a deadline.

import { h, s, select, short, slider } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { data } from "viewer/data.js";
import { look } from "viewer/colours.js";
import { chart, path, span } from "viewer/chart.js";
import { frameTimes, mean, paretoFront, rank } from "viewer/decide.js";

const MARKS = [[16.7, "60 fps"], [33.3, "30 fps"], [100, "10 fps"]]; // deadlines that are drawn
const LISTED = 12; // methods in the ranking
const NAMED = 8; // curves with a colour

/** The measured cost of a sample, and the first usual deadline that half of the methods meet. */
export function firstQuestion() {
  const first = data.devices[0]?.decide[0]?.scopes[0];
  if (!(first?.sample_ms > 0)) return {};
  const sample = Number(first.sample_ms.toPrecision(3));
  const least = first.curves.map((curve) => Math.min(...frameTimes(curve, sample))).sort((a, b) => a - b);
  const needed = least[Math.floor(least.length / 2)];
  return { sample, deadline: [16.7, 33.3, 100, 250, 500].find((time) => time >= needed) ?? 1000 };
}

function cheapest(curves, sampleMs) {
  const points = curves.flatMap((curve) => frameTimes(curve, sampleMs).map((time, i) => ({ time, curve, spp: curve.spp[i] })));
  return points.reduce((least, point) => (point.time < least.time ? point : least));
}

const device = () => data.devices[state.device] ?? data.devices[0];
const metric = () => device().decide.find((each) => each.metric === state.metric) ?? device().decide[0];
const scope = () => metric().scopes.find((each) => each.name === state.scope) ?? metric().scopes[0];

export function decideView() {
  if (!data.devices.some((each) => each.decide.length)) {
    return { element: h("p", { class: "hint" }, "no method has scores and times on every scene; measure with rlbench run"), update() {} };
  }
  const log = { min: -1, max: 3, step: 0.01 };
  const milliseconds = (power) => `${short(10 ** power)} ms`;
  const ms = (power) => Number((10 ** power).toPrecision(3));
  const controls = [
    slider("cost of a sample", log, () => Math.log10(state.sample), (power) => set({ sample: ms(power) }), milliseconds),
    slider("deadline", log, () => Math.log10(state.deadline), (power) => set({ deadline: ms(power) }), milliseconds),
    select("scene", () => metric().scopes.map((each) => [each.name, each.name]), () => scope().name, (value) => set({ scope: value })),
    select("score", () => device().decide.map((each) => [each.metric, each.metric]), () => metric().metric, (value) => set({ metric: value })),
    select("device", () => data.devices.map((each, i) => [i, each.name || "unnamed device"]), () => state.device, (value) => set({ device: Number(value) })),
  ];
  const measured = h("button", { type: "button", onclick: () => set({ sample: Number(scope().sample_ms.toPrecision(3)) }) }, "measured cost");
  const [answer, plot, ranking, notes] = [h("p", { class: "answer", role: "status" }), h("div", { class: "plot" }), h("div", { class: "scroll" }), h("p", { class: "hint" })];
  const element = h("section", {}, h("div", { class: "toolbar" }, controls.map((each) => each.element), measured), answer,
    h("div", { class: "beside" }, plot, ranking), notes);
  const update = () => {
    controls.forEach((each) => each.update());
    measured.hidden = !(scope().sample_ms > 0);
    const options = { sign: metric().sign, unit: metric().unit, student: data.student, tie: data.tie_db };
    const ranked = rank(scope().curves, state.sample, state.deadline, options);
    answer.replaceChildren(...describe(ranked));
    plot.replaceChildren(drawCurves(ranked));
    ranking.replaceChildren(tabulate(ranked));
    notes.textContent = [`${metric().metric}: ${metric().convention}.`,
      `Frame time: inference on ${device().name || "an unnamed device"} + drawn samples x cost of a sample (measured: ${short(scope().sample_ms)} ms, ${metric().cost_source || "no source"}).`,
      `Intervals: 95 %, Student's t over ${scope().unit}. Between measured budgets scores are linear in log spp; none is extrapolated.`,
      `${data.unreliable_mark} a time of this method is unreliable.`, ...scope().missing.map((each) => `${each}.`)].join(" ");
  };
  return { element, update };
}

const unitText = () => (metric().unit ? ` ${metric().unit}` : "");
const number = (value) => (metric().unit === "dB" ? value.toFixed(2) : short(value));
const bracket = ({ low, high }) => (Number.isNaN(low) ? "" : ` [${number(low)}, ${number(high)}]`);
const mark = (each) => (each.isUnreliable ? data.unreliable_mark : "");

function describe(ranked) {
  if (!ranked.length) {
    const { time, curve, spp } = cheapest(scope().curves, state.sample);
    return [h("strong", {}, "No method fits. "), `The cheapest, ${curve.method} at ${short(spp)} spp, needs ${short(time)} ms.`];
  }
  const [first, second] = ranked;
  const others = ranked.slice(1).filter((each) => each.verdict === "tie" || each.verdict === "not resolved");
  const parts = [h("strong", { "data-winner": first.method }, first.method + mark(first)),
    ` at ${short(first.spp)} spp: ${number(first.mean)}${unitText()}${bracket(first)} in ${short(first.frameMs)} ms`, first.isLargest ? ", its largest measured budget. " : ". "];
  if (second) {
    const gap = { mean: -second.gap.mean, low: -second.gap.high, high: -second.gap.low };
    const words = { trails: "Leads", tie: "A tie with", "not resolved": "Not resolved from" }[second.verdict] ?? "No interval, since there is one clip, to";
    parts.push(`${words} ${second.method}${mark(second)}: ${number(gap.mean)}${unitText()}${bracket(gap)}.`);
  }
  if (others.length > 1) parts.push(` ${others.length} methods tie with it or are not resolved from it.`);
  return parts;
}

function tabulate(ranked) {
  const header = ["", "method", "spp", metric().metric, "to the winner", "frame ms", ""];
  return h("table", { class: "ranking" }, h("caption", {}, "methods that fit"),
    h("thead", {}, h("tr", {}, header.map((text) => h("th", { scope: "col" }, text)))),
    h("tbody", {}, ranked.slice(0, LISTED).map((each, i) => h("tr", { "data-row": each.method },
      h("td", {}, i + 1), h("th", { scope: "row" }, h("span", { class: "swatch", style: `background:${look(each.method).colour}` }), each.method + mark(each)),
      h("td", {}, short(each.spp) + (each.isLargest ? " max" : "")), h("td", {}, number(each.mean)),
      h("td", {}, i ? number(each.gap.mean) + bracket(each.gap) : "–"), h("td", {}, short(each.frameMs)), h("td", {}, each.verdict)))));
}

function drawCurves(ranked) {
  const { curves } = scope();
  const times = curves.flatMap((curve) => frameTimes(curve, state.sample));
  const scores = curves.flatMap((curve) => curve.units.map(mean));
  const [from, to] = span(scores);
  const width = Math.min(620, document.documentElement.clientWidth - 32);
  const least = Math.max(Math.min(...times, state.deadline), 0.01);
  const { svg, plot, px, py, box } = chart({ width, height: 420, label: "score against frame time",
    x: { from: least / 1.3, to: Math.max(...times, state.deadline) * 1.3, log: true, label: "frame time [ms]" },
    y: { from, to, label: `${metric().metric}${metric().unit ? ` [${metric().unit}]` : ""}` } });
  for (const [time, text] of [...MARKS, [state.deadline, "deadline"]]) {
    const isChosen = text === "deadline";
    if (time > Math.max(...times, state.deadline) * 1.3) continue;
    plot.append(s("line", { class: isChosen ? "deadline" : "mark", x1: px(time), x2: px(time), y1: box.top, y2: box.bottom }),
      s("text", { class: "mark-text", x: px(time) - 4, y: isChosen ? box.bottom - 22 : box.bottom - 6, "text-anchor": "end" }, text));
  }
  plot.append(s("path", { class: "front", d: path(paretoFront(curves, state.sample, metric().sign).map((p) => [px(p.time), py(p.score)])) }));
  const named = ranked.slice(0, NAMED).map((each) => each.method);
  for (const curve of [...curves].sort((one, other) => named.indexOf(other.method) - named.indexOf(one.method))) {
    const isNamed = named.includes(curve.method);
    const { colour, dash } = isNamed ? look(curve.method) : { colour: "var(--faint)", dash: "" };
    const points = frameTimes(curve, state.sample).map((time, i) => [px(time), py(mean(curve.units[i]))]);
    plot.append(s("g", { "data-curve": curve.method }, s("title", {}, curve.method),
      s("path", { d: path(points), class: "curve", stroke: colour, "stroke-dasharray": dash }),
      points.map(([cx, cy], i) => s("circle", { cx, cy, r: isNamed ? 3.5 : 2, stroke: colour, fill: curve.unreliable[i] ? "var(--paper)" : colour }))));
  }
  if (ranked.length) {
    const [first] = ranked;
    plot.append(s("circle", { class: "winner", cx: px(first.frameMs), cy: py(first.mean), r: 8 }));
  }
  return svg;
}
