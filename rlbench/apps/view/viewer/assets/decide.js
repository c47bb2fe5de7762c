// Which denoiser gives the least error in a frame time: reports/analysis/curves.py and decide.py in
// the page, so that sliders answer at once.

const TINY = 1e-9; // stands for a budget of 0 spp, whose logarithm would be infinite
const logs = (spp) => Math.log(Math.max(spp, TINY));

/** Frame time at each measured budget, ms; of the ends of its interval with `end` low_ms, high_ms. */
export function frameTimes(curve, sampleMs, end = "fixed_ms") {
  const gbuffer = curve.gbuffer_ms + curve.gbuffer_samples * sampleMs;
  return curve[end].map((fixed, i) => gbuffer + fixed + curve.samples[i] * sampleMs);
}

/** Frame time at any budget between the smallest and the largest measured one; NaN outside. */
export function frameTimeAt(curve, spp, sampleMs) {
  return interpolate(spp, curve.spp, frameTimes(curve, sampleMs), (x) => x);
}

/** The scores of all scenes (or clips) at any budget; NaN outside of the measured ones. */
export function unitsAt(curve, spp) {
  return curve.units[0].map((_, unit) =>
    interpolate(
      spp,
      curve.spp,
      curve.units.map((row) => row[unit]),
      logs,
    ),
  );
}

export const mean = (numbers) => numbers.reduce((sum, number) => sum + number, 0) / numbers.length;

/** The budget with the best score whose frame time is within the deadline; NaN if none is. */
export function bestSpp(curve, sampleMs, deadline, sign) {
  const times = frameTimes(curve, sampleMs);
  const fits = times.map((time) => time <= deadline);
  const candidates = curve.spp.filter((_, i) => fits[i]);
  for (let i = 0; i + 1 < times.length; i++) {
    if (fits[i] === fits[i + 1] || curve.spp[i] <= 0) continue;
    const share = (deadline - times[i]) / (times[i + 1] - times[i]);
    candidates.push(curve.spp[i] + share * (curve.spp[i + 1] - curve.spp[i]));
  }
  let best = NaN;
  let highest = -Infinity;
  for (const spp of candidates) {
    const score = sign * mean(unitsAt(curve, spp));
    if (score > highest) [best, highest] = [spp, score];
  }
  return best;
}

/** Mean and 95 % interval of independent numbers by Student's t; the ends are NaN below two. */
export function interval(units, student) {
  const centre = mean(units);
  if (units.length < 2) return { mean: centre, low: NaN, high: NaN };
  const variance = units.reduce((sum, unit) => sum + (unit - centre) ** 2, 0) / (units.length - 1);
  const half = student[units.length] * Math.sqrt(variance / units.length);
  return { mean: centre, low: centre - half, high: centre + half };
}

/** What a difference to the winner is called. */
export function verdict(gap, unit, tie) {
  if (Number.isNaN(gap.low)) return "";
  if (unit === "dB" && gap.low >= -tie && gap.high <= tie) return "tie";
  return gap.low <= 0 && gap.high >= 0 ? "not resolved" : "trails";
}

/** The denoisers that would win with their times at the low, and all others at the high end. */
export function possibleWinners(curves, sampleMs, deadline, sign) {
  const competing = curves.filter((each) => each.competes);
  const scores = (end) =>
    competing.map((curve) => {
      const spp = bestSpp({ ...curve, fixed_ms: curve[end] }, sampleMs, deadline, sign);
      return Number.isNaN(spp) ? -Infinity : sign * mean(unitsAt(curve, spp));
    });
  const [best, worst] = [scores("low_ms"), scores("high_ms")];
  return competing.filter(
    (_, i) => best[i] > -Infinity && worst.every((score, j) => j === i || best[i] >= score),
  );
}

/** How far frame times may be from the ends of their intervals, as a share of them. */
export function uncertainty(curve, sampleMs) {
  const [times, low, high] = ["fixed_ms", "low_ms", "high_ms"].map((end) => frameTimes(curve, sampleMs, end));
  return Math.max(...times.map((time, i) => Math.max(high[i] / time, time / low[i]) - 1));
}

/** Every denoiser that fits the deadline at its best budget, the best first. */
export function rank(curves, sampleMs, deadline, { sign, unit, student, tie }) {
  const fitting = curves.flatMap((curve) => {
    if (!curve.competes) return [];
    const spp = bestSpp(curve, sampleMs, deadline, sign);
    if (Number.isNaN(spp)) return [];
    const units = unitsAt(curve, spp);
    return [
      {
        curve,
        method: curve.method,
        spp,
        units,
        ...interval(units, student),
        frameMs: frameTimeAt(curve, spp, sampleMs),
        isLargest: spp === curve.spp.at(-1),
      },
    ];
  });
  fitting.sort((a, b) => sign * (b.mean - a.mean));
  for (const each of fitting) {
    each.gap = interval(
      each.units.map((value, i) => value - fitting[0].units[i]),
      student,
    );
    each.verdict = each === fitting[0] ? "" : verdict(each.gap, unit, tie);
  }
  return fitting;
}

/** Points [time, score, curve, budget index] that no cheaper point beats. */
export function paretoFront(curves, sampleMs, sign) {
  const points = curves.flatMap((curve) =>
    frameTimes(curve, sampleMs).map((time, i) => ({
      time,
      score: mean(curve.units[i]),
      curve,
      index: i,
    })),
  );
  points.sort((a, b) => a.time - b.time || sign * (b.score - a.score));
  const front = [];
  for (const point of points) {
    if (!front.length || sign * (point.score - front.at(-1).score) > 0) front.push(point);
  }
  return front;
}

function interpolate(x, xs, ys, warp) {
  if (!(x >= xs[0] && x <= xs.at(-1))) return NaN;
  if (xs.length === 1) return ys[0];
  let i = 0;
  while (i + 2 < xs.length && x > xs[i + 1]) i++;
  const share = (warp(x) - warp(xs[i])) / (warp(xs[i + 1]) - warp(xs[i]));
  return ys[i] + share * (ys[i + 1] - ys[i]);
}
