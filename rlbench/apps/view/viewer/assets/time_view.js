// Time: scores of frames, slices through time, and the worst tiles of method A.

import { h, s, select } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { data } from "viewer/data.js";
import { looks } from "viewer/colours.js";
import { chart, path, span } from "viewer/chart.js";
import { drawSlices, sliceLine } from "viewer/slices.js";
import { clip, imageLook, methods, picture } from "viewer/workspace.js";
import { listWorst, TILE } from "viewer/worst_tiles.js";

export const gesture = "line";
export { sliceLine };

export function panes() {
  const look = imageLook();
  return [state.a, "reference"].map((name) => ({ label: name, image: picture(name), look }));
}

export function extras() {
  const metric = select(
    "score",
    () => metricsOf().map((name) => [name, name]),
    chosenMetric,
    (value) => set({ metric: value }),
  );
  const method = select(
    "method A",
    () => methods().map((name) => [name, name]),
    () => state.a,
    (a) => set({ a }),
  );
  const curves = h("div", { class: "plot" });
  const slices = h("div", { class: "slices" });
  const worst = h("ol", { class: "worst" });
  const element = h(
    "div",
    {},
    h("div", { class: "toolbar" }, method.element, metric.element),
    curves,
    h(
      "h3",
      {},
      "Slice through time ",
      h("small", {}, "drag a line on the image; time runs down; click to jump to a frame"),
    ),
    slices,
    h("h3", {}, "Worst tiles of method A ", h("small", {}, `${TILE} x ${TILE} pixels, all frames`)),
    worst,
  );
  const update = () => {
    metric.update();
    method.update();
    curves.replaceChildren(scoreChart());
    drawSlices(slices);
    listWorst(worst);
  };
  return { element, update };
}

const metricsOf = () => [
  ...new Set(data.frames.filter((each) => each.clip === clip().name).map((each) => each.metric)),
];
const chosenMetric = () => (metricsOf().includes(state.metric) ? state.metric : metricsOf()[0]);

function scoreChart() {
  const names = methods();
  const shown = data.frames.filter(
    (each) =>
      each.clip === clip().name &&
      each.spp === state.spp &&
      each.metric === chosenMetric() &&
      names.includes(each.method),
  );
  if (!shown.length) return h("p", { class: "hint" }, "no scores of frames");
  shown.sort((one, other) => names.indexOf(one.method) - names.indexOf(other.method));
  const unit = data.devices
    .flatMap((d) => d.table.metrics)
    .find((m) => m.metric === chosenMetric())?.unit;
  const look = looks(names);
  const [from, to] = span(shown.flatMap((each) => each.values.filter((value) => value !== null)));
  const width = Math.min(900, document.documentElement.clientWidth - 32);
  const last = Math.max(1, clip().frames - 1);
  const { svg, plot, px, py, box } = chart({
    width,
    height: 260,
    label: `${chosenMetric()} of each frame`,
    x: {
      from: -0.2,
      to: last + 0.2,
      label: "frame; dotted: cut; dashed: light change",
      whole: true,
    },
    y: { from, to, label: unit ? `${chosenMetric()} [${unit}]` : chosenMetric() },
  });
  const event = (kind) => (frame) => {
    const x = px(frame - 0.5);
    return s("line", { class: kind, x1: x, x2: x, y1: box.top, y2: box.bottom });
  };
  plot.append(...clip().cuts.map(event("cut")), ...clip().light_changes.map(event("light")));
  plot.append(
    s("line", {
      class: "now",
      x1: px(state.frame),
      x2: px(state.frame),
      y1: box.top,
      y2: box.bottom,
    }),
  );
  for (const each of shown) {
    const { colour, dash } = look.get(each.method);
    const points = each.values.map((value, frame) => [px(frame), value === null ? NaN : py(value)]);
    plot.append(
      s(
        "path",
        {
          d: path(points),
          stroke: colour,
          "stroke-dasharray": dash,
          class: each.method === state.a ? "curve is-a" : "curve",
        },
        s("title", {}, each.method),
      ),
    );
    plot.append(
      ...points
        .filter(([, y]) => Number.isFinite(y))
        .map(([cx, cy]) => s("circle", { cx, cy, r: 2.5, fill: colour })),
    );
  }
  svg.addEventListener("click", (event) => {
    const box = svg.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * width;
    const frame = Math.round((x - px(0)) / (px(1) - px(0)));
    set({ frame: Math.min(Math.max(frame, 0), clip().frames - 1) });
  });
  svg.dataset.px0 = px(0);
  svg.dataset.px1 = px(1);
  return h("div", {}, svg, legend(look));
}

/** Names of methods beside their lines. */
function legend(look) {
  return h(
    "ul",
    { class: "legend-list" },
    [...look].map(([name, { colour, dash }]) => {
      return h(
        "li",
        {},
        s(
          "svg",
          { width: 26, height: 10 },
          s("line", {
            x1: 1,
            x2: 25,
            y1: 5,
            y2: 5,
            stroke: colour,
            "stroke-dasharray": dash,
            "stroke-width": 2.5,
          }),
        ),
        ` ${name}`,
      );
    }),
  );
}
