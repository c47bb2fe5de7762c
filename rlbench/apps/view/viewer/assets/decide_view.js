// Decide: which method gives the least error at a cost of a sample and a deadline.

import { h, select, short, slider } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { data } from "viewer/data.js";
import { looks } from "viewer/colours.js";
import { frameTimes, mean, possibleWinners, rank, uncertainty } from "viewer/decide.js";
import { drawCurves } from "viewer/decide_chart.js";
import { crops } from "viewer/decide_crops.js";
import { doubt } from "viewer/table_rows.js";

const LISTED = 12; // methods in the ranking
const NAMED = 12; // curves with a colour
const MENTIONED = 4; // methods that a sentence names

function cheapest(curves, sampleMs) {
  const points = curves
    .filter((each) => each.competes)
    .flatMap((curve) =>
      frameTimes(curve, sampleMs).map((time, i) => ({ time, curve, spp: curve.spp[i] })),
    );
  return points.reduce((least, point) => (point.time < least.time ? point : least));
}

const device = () => data.devices[state.device] ?? data.devices[0];
const metric = () =>
  device().decide.find((each) => each.metric === state.metric) ?? device().decide[0];
const scope = () => metric().scopes.find((each) => each.name === state.scope) ?? metric().scopes[0];

export function decideView() {
  if (!data.devices.some((each) => each.decide.length)) {
    return {
      element: h(
        "p",
        { class: "hint" },
        "no method has scores and times on every scene; measure with rlbench run",
      ),
      update() {},
    };
  }
  const log = { min: -1, max: 3, step: 0.01 };
  const milliseconds = (power) => `${short(10 ** power)} ms`;
  const ms = (power) => Number((10 ** power).toPrecision(3));
  const controls = [
    slider(
      "cost of a sample",
      log,
      () => Math.log10(state.sample),
      (power) => set({ sample: ms(power) }),
      milliseconds,
    ),
    slider(
      "deadline",
      log,
      () => Math.log10(state.deadline),
      (power) => set({ deadline: ms(power) }),
      milliseconds,
    ),
    select(
      "scene",
      () => metric().scopes.map((each) => [each.name, each.name]),
      () => scope().name,
      (value) => set({ scope: value }),
    ),
    select(
      "score",
      () => device().decide.map((each) => [each.metric, each.title]),
      () => metric().metric,
      (value) => set({ metric: value }),
    ),
    select(
      "device",
      () => data.devices.map((each, i) => [i, each.place]),
      () => state.device,
      (value) => set({ device: Number(value) }),
    ),
  ];
  const measured = h(
    "button",
    { type: "button", onclick: () => set({ sample: Number(scope().sample_ms.toPrecision(3)) }) },
    "measured cost",
  );
  const [answer, plot, ranking, pictures, notes] = [
    h("p", { class: "answer", role: "status" }),
    h("div", { class: "plot" }),
    h("div", { class: "scroll grows" }),
    h("div", { class: "crops" }),
    h("p", { class: "hint" }),
  ];
  const element = h(
    "section",
    {},
    h(
      "div",
      { class: "toolbar" },
      controls.map((each) => each.element),
      measured,
    ),
    answer,
    h("div", { class: "beside" }, plot, ranking),
    pictures,
    notes,
  );
  const update = () => {
    controls.forEach((each) => each.update());
    measured.hidden = !(scope().sample_ms > 0);
    const options = {
      sign: metric().sign,
      unit: metric().unit,
      student: data.student,
      tie: data.tie_db,
    };
    const ranked = rank(scope().curves, state.sample, state.deadline, options);
    const possible = possibleWinners(scope().curves, state.sample, state.deadline, metric().sign);
    answer.replaceChildren(...describe(ranked, possible));
    crops(pictures, ranked, scope().name);
    plot.replaceChildren(
      drawCurves({ curves: scope().curves, metric: metric(), ranked, look: lookOf(ranked) }),
    );
    ranking.replaceChildren(tabulate(ranked));
    notes.textContent = [
      `${metric().title}: ${metric().convention}.`,
      ...metric().device_mixes.map((each) => `Two devices: ${each}.`),
      `Frame time: ${gbufferText()} + inference on ${device().place} + drawn samples x cost of a sample (measured: ${short(scope().sample_ms)} ms, ${metric().cost_source || "no source"}).`,
      `Intervals: 95 %, Student's t over ${scope().unit}. Between measured budgets scores are linear in log spp; none is extrapolated.`,
      ...doubts(scope()),
      ...scope().missing.map((each) => `${each}.`),
    ].join(" ");
  };
  return { element, update };
}

const unitText = () => (metric().unit ? ` ${metric().unit}` : "");
const number = (value) => (metric().unit === "dB" ? value.toFixed(2) : short(value));
const bracket = ({ low, high }) => (Number.isNaN(low) ? "" : ` [${number(low)}, ${number(high)}]`);
function gbufferText() {
  const reading = scope().curves.find((each) => each.gbuffer_ms || each.gbuffer_samples);
  if (!reading) return "G-buffer (0 or not known: rlbench view --gbuffer-ms)";
  if (reading.gbuffer_ms) return `G-buffer (${short(reading.gbuffer_ms)} ms)`;
  return `G-buffer (${short(reading.gbuffer_samples)} samples, as measured; yours: rlbench view --gbuffer-ms)`;
}
function doubts({ curves, uncertain_times }) {
  const isWide = curves.some((curve) => curve.low_ms.some((low, i) => low < curve.high_ms[i]));
  const bars = isWide ? ["Hollow with a bar: an uncertain time and its interval."] : [];
  return [...bars, ...uncertain_times.map((each) => `Uncertain: ${each}.`)];
}

/** Colours of the curves: all of a few; of many, those that fit, and then the best. */
function lookOf(ranked) {
  const best = (curve) => Math.max(...curve.units.map((units) => metric().sign * mean(units)));
  const others = [...scope().curves].sort((one, other) => best(other) - best(one));
  const names = new Set([...ranked, ...others].map((each) => each.method));
  return looks([...names].slice(0, NAMED));
}

const listNames = (names) =>
  names.slice(0, MENTIONED).join(", ") +
  (names.length > MENTIONED ? ` and ${names.length - MENTIONED} more` : "");

function describe(ranked, possible) {
  if (!ranked.length) {
    const { time, curve, spp } = cheapest(scope().curves, state.sample);
    const open = possible.map((each) => each.method);
    return [
      h("strong", {}, "No denoiser with a time fits. "),
      `The cheapest, ${curve.method} at ${short(spp)} spp, needs ${short(time)} ms${doubt(uncertainty(curve, state.sample))}. `,
      open.length ? `Times are uncertain: ${listNames(open)} may fit. ` : "",
      `These are times of ${device().place}.`,
    ];
  }
  const [first, second] = ranked;
  const others = ranked
    .slice(1)
    .filter((each) => each.verdict === "tie" || each.verdict === "not resolved");
  const parts = [
    h("strong", { "data-winner": first.method }, first.method),
    ` at ${short(first.spp)} spp: ${number(first.mean)}${unitText()}${bracket(first)} in ${short(first.frameMs)} ms`,
    first.isLargest ? ", its largest measured budget. " : ". ",
  ];
  if (second) {
    const gap = { mean: -second.gap.mean, low: -second.gap.high, high: -second.gap.low };
    const words =
      { trails: "Leads", tie: "A tie with", "not resolved": "Not resolved from" }[second.verdict] ??
      "No interval, since there is one clip, to";
    parts.push(`${words} ${second.method}: ${number(gap.mean)}${unitText()}${bracket(gap)}.`);
  }
  const rivals = possible.filter((each) => each.method !== first.method);
  if (rivals.length) {
    const involved = [first.curve, ...rivals].map((each) => uncertainty(each, state.sample));
    parts.push(
      ` Times here are uncertain by ${Math.round(100 * Math.max(...involved))} %: ${listNames(rivals.map((each) => each.method))} could take its place.`,
    );
  }
  if (others.length > 1)
    parts.push(` ${others.length} methods tie with it or are not resolved from it.`);
  return parts;
}

function tabulate(ranked) {
  const look = lookOf(ranked);
  const header = ["", "method", "spp", metric().title, "to the winner", "frame ms", ""];
  return h(
    "table",
    { class: "ranking" },
    h("caption", {}, "denoisers that fit"),
    h(
      "thead",
      {},
      h(
        "tr",
        {},
        header.map((text) => h("th", { scope: "col" }, text)),
      ),
    ),
    h(
      "tbody",
      {},
      ranked.slice(0, LISTED).map((each, i) =>
        h(
          "tr",
          { "data-row": each.method },
          h("td", {}, i + 1),
          h(
            "th",
            { scope: "row" },
            h("span", {
              class: "swatch",
              style: `background:${look.get(each.method)?.colour ?? "var(--faint)"}`,
            }),
            each.method,
          ),
          h("td", {}, short(each.spp) + (each.isLargest ? " max" : "")),
          h("td", {}, number(each.mean)),
          h("td", {}, i ? number(each.gap.mean) + bracket(each.gap) : "–"),
          h("td", {}, short(each.frameMs) + doubt(uncertainty(each.curve, state.sample))),
          h("td", {}, each.verdict),
        ),
      ),
    ),
  );
}
