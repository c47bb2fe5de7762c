// The rows of the table: what is chosen, filtered and sorted, and how numbers are written.

import { short } from "viewer/dom.js";
import { state } from "viewer/state.js";
import { data } from "viewer/data.js";

const INPUTS = ["albedo", "normal", "depth", "motion"];
export const FILTERS = {
  learned: (traits) => traits.learned === true,
  "by rule": (traits) => traits.learned === false,
  adaptive: (traits) => traits.adaptive === true,
  temporal: (traits) => traits.temporal === true,
  ...Object.fromEntries(
    INPUTS.map((name) => [
      `without ${name}`,
      (traits) => traits.inputs && !traits.inputs.includes(name),
    ]),
  ),
};

export const device = () => data.devices[state.device] ?? data.devices[0];
export const metric = () =>
  device().table.metrics.find((each) => each.metric === state.metric) ?? device().table.metrics[0];
export const scopes = () =>
  [...new Set(metric().records.map((each) => each.scene))].sort(
    (a, b) => (b === "all") - (a === "all") || a.localeCompare(b),
  );
export const scope = () => (scopes().includes(state.scope) ? state.scope : scopes()[0]);
export const budgets = () =>
  [...new Set(metric().records.map((each) => each.target_spp))].sort((a, b) => a - b);

export const chosen = () => state.filter.split(",").filter(Boolean);

/** The rows that are shown, in their order. */
export function rows() {
  const shown = metric().records.filter(
    (each) =>
      each.scene === scope() &&
      (state.tspp === "" || each.target_spp === Number(state.tspp)) &&
      each.method.includes(state.search) &&
      chosen().every((name) => FILTERS[name]?.(data.traits[each.method] ?? {})),
  );
  const missing = (value) => value === null || value === undefined;
  const sign = state.up ? 1 : -1;
  return shown.sort((a, b) => {
    const [x, y] = [a[state.sort], b[state.sort]];
    if (missing(x) || missing(y)) return missing(x) - missing(y);
    return (
      sign * (typeof x === "string" ? x.localeCompare(y) : x - y) ||
      a.method.localeCompare(b.method)
    );
  });
}

export const score = (value) =>
  value === null || value === undefined
    ? "–"
    : metric().unit === "dB"
      ? value.toFixed(2)
      : short(value);
export const time = (row, part) => {
  const [value, share] = [row[`${part}_ms`], row[`${part}_uncertainty`]];
  return value === null || value === undefined ? "–" : short(value) + doubt(share);
};
/** What stands after an uncertain time; nothing after others. A share without a bound is null. */
export const doubt = (share) =>
  share === null || share > data.wide ? ` ±${share === null ? "∞" : Math.round(100 * share)} %` : "";
export const difference = (row) =>
  row.best
    ? "best"
    : score(row.difference) + (row.low === null ? "" : ` [${score(row.low)}, ${score(row.high)}]`);

/** The rows as a table of texts, header first. */
export function texts(shown) {
  const title = `${metric().title}${metric().unit ? ` [${metric().unit}]` : ""}`;
  return [
    ["method", "spp", title, "to the best", "inference ms", "frame ms", "verdict"],
    ...shown.map((row) => [
      row.method,
      short(row.target_spp),
      score(row.mean),
      difference(row),
      time(row, "inference"),
      time(row, "frame"),
      row.verdict + row.mark,
    ]),
  ];
}
