// Axes and curves in SVG.

import { s, short } from "viewer/dom.js";

const LEFT = 52,
  RIGHT = 12,
  TOP = 12,
  BOTTOM = 40;

/** An empty chart with axes: `svg`, the group `plot`, and `px`, `py` from values to pixels. */
export function chart({ width, height, x, y, label }) {
  const px = axis(x, LEFT, width - RIGHT);
  const py = axis(y, height - BOTTOM, TOP);
  const plot = s("g");
  const clip = `clip-${label.replace(/\W+/g, "-")}`;
  const svg = s(
    "svg",
    {
      viewBox: `0 0 ${width} ${height}`,
      width,
      height,
      role: "img",
      "aria-label": label,
      class: "chart",
    },
    s(
      "clipPath",
      { id: clip },
      s("rect", { x: LEFT, y: TOP, width: width - LEFT - RIGHT, height: height - TOP - BOTTOM }),
    ),
    s(
      "g",
      { class: "axis" },
      ticks(x).map((value) => [
        s("line", { x1: px(value), x2: px(value), y1: TOP, y2: height - BOTTOM }),
        s("text", { x: px(value), y: height - BOTTOM + 16, "text-anchor": "middle" }, short(value)),
      ]),
      ticks(y).map((value) => [
        s("line", { x1: LEFT, x2: width - RIGHT, y1: py(value), y2: py(value) }),
        s("text", { x: LEFT - 6, y: py(value) + 4, "text-anchor": "end" }, short(value, 4)),
      ]),
      s("text", { x: (LEFT + width - RIGHT) / 2, y: height - 6, "text-anchor": "middle" }, x.label),
      s(
        "text",
        {
          transform: `translate(12 ${(TOP + height - BOTTOM) / 2}) rotate(-90)`,
          "text-anchor": "middle",
        },
        y.label,
      ),
    ),
    plot,
  );
  plot.setAttribute("clip-path", `url(#${clip})`);
  return {
    svg,
    plot,
    px,
    py,
    box: { left: LEFT, right: width - RIGHT, top: TOP, bottom: height - BOTTOM },
  };
}

/** The path through points [x, y] in pixels; a gap where one is not finite. */
export function path(points) {
  let command = "M";
  return points
    .map(([x, y]) => {
      if (!Number.isFinite(x) || !Number.isFinite(y)) {
        command = "M";
        return "";
      }
      const part = `${command}${x.toFixed(1)} ${y.toFixed(1)}`;
      command = "L";
      return part;
    })
    .join("");
}

/** The span of numbers with a margin; of a single number, around it. */
export function span(numbers, margin = 0.06) {
  const known = numbers.filter(Number.isFinite);
  const [low, high] = [Math.min(...known), Math.max(...known)];
  const extra = (high - low) * margin || Math.abs(high) * margin || 1;
  return [low - extra, high + extra];
}

function axis({ from, to, log }, first, last) {
  const warp = log ? Math.log : (value) => value;
  return (value) => first + ((warp(value) - warp(from)) / (warp(to) - warp(from))) * (last - first);
}

function ticks({ from, to, log, whole }) {
  if (log) {
    const found = [];
    const steps = Math.log10(to / from) > 2.2 ? [1] : [1, 2, 5];
    for (let power = Math.floor(Math.log10(from)); power <= Math.log10(to); power++) {
      found.push(...steps.map((step) => step * 10 ** power));
    }
    return found.filter((value) => value >= from && value <= to);
  }
  const rough = (to - from) / 5;
  const power = 10 ** Math.floor(Math.log10(rough));
  let step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= rough);
  if (whole) step = Math.max(1, step);
  const first = Math.ceil(from / step);
  return Array.from({ length: Math.floor(to / step) - first + 1 }, (_, i) =>
    Number(((first + i) * step).toPrecision(12)),
  );
}
