// The chart of Decide: a curve over budgets for each method, deadlines, and the front.

import { s } from "viewer/dom.js";
import { state } from "viewer/state.js";
import { chart, path, span } from "viewer/chart.js";
import { frameTimes, mean, paretoFront } from "viewer/decide.js";

const MARKS = [
  [16.7, "60 fps"],
  [33.3, "30 fps"],
  [100, "10 fps"],
]; // deadlines that are drawn

const ENDS = ["fixed_ms", "low_ms", "high_ms"];

/** Score against frame time of all curves of a question: {curves, metric, ranked, look}. */
export function drawCurves({ curves, metric, ranked, look }) {
  const times = curves.flatMap((curve) => ENDS.flatMap((end) => frameTimes(curve, state.sample, end)));
  const scores = curves.flatMap((curve) => curve.units.map(mean));
  const [from, to] = span(scores);
  const room = document.documentElement.clientWidth - 32;
  const width = room < 900 ? Math.min(room, 560) : Math.min(820, room * 0.52);
  const least = Math.max(Math.min(...times, state.deadline), 0.01);
  const { svg, plot, px, py, box } = chart({
    width,
    height: 420,
    label: "score against frame time",
    x: {
      from: least / 1.3,
      to: Math.max(...times, state.deadline) * 1.3,
      log: true,
      label: "frame time [ms]",
    },
    y: { from, to, label: `${metric.title}${metric.unit ? ` [${metric.unit}]` : ""}` },
  });
  for (const [time, text] of [...MARKS, [state.deadline, "deadline"]]) {
    const isChosen = text === "deadline";
    const isNearEdge = px(time) < box.left + 48; // a label at its left would be cut
    if (time > Math.max(...times, state.deadline) * 1.3 || time < least / 1.3) continue;
    plot.append(
      s("line", {
        class: isChosen ? "deadline" : "mark",
        x1: px(time),
        x2: px(time),
        y1: box.top,
        y2: box.bottom,
      }),
      s(
        "text",
        {
          class: "mark-text",
          x: px(time) + (isNearEdge ? 4 : -4),
          y: isChosen ? box.bottom - 22 : box.bottom - 6,
          "text-anchor": isNearEdge ? "start" : "end",
        },
        text,
      ),
    );
  }
  plot.append(
    s("path", {
      class: "front",
      d: path(paretoFront(curves, state.sample, metric.sign).map((p) => [px(p.time), py(p.score)])),
    }),
  );
  const named = [...look.keys()];
  for (const curve of [...curves].sort(
    (one, other) => named.indexOf(other.method) - named.indexOf(one.method),
  )) {
    const isNamed = look.has(curve.method);
    const { colour, dash } = look.get(curve.method) ?? { colour: "var(--faint)", dash: "" };
    const points = frameTimes(curve, state.sample).map((time, i) => [
      px(time),
      py(mean(curve.units[i])),
    ]);
    plot.append(
      s(
        "g",
        { "data-curve": curve.method },
        s("title", {}, curve.method),
        s("path", { d: path(points), class: "curve", stroke: colour, "stroke-dasharray": dash }),
        points.map(([, y], i) => bar(curve, i, y, px, colour)),
        points.map(([cx, cy], i) =>
          s("circle", {
            cx,
            cy,
            r: isNamed ? 3.5 : 2,
            stroke: colour,
            fill: curve.low_ms[i] < curve.high_ms[i] ? "var(--paper)" : colour,
          }),
        ),
      ),
    );
  }
  if (ranked.length) {
    const [first] = ranked;
    plot.append(s("circle", { class: "winner", cx: px(first.frameMs), cy: py(first.mean), r: 8 }));
  }
  return svg;
}

/** The interval of an uncertain time; nothing for others. */
function bar(curve, i, y, px, colour) {
  if (!(curve.low_ms[i] < curve.high_ms[i])) return null;
  const [x1, x2] = ["low_ms", "high_ms"].map((end) => px(frameTimes(curve, state.sample, end)[i]));
  return s("line", { class: "doubt", x1, x2, y1: y, y2: y, stroke: colour });
}
