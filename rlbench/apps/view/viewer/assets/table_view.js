// Table: all methods, sorted and filtered, with intervals as bars.

import { h, s, select, short } from "viewer/dom.js";
import { permalink, set, state } from "viewer/state.js";
import { data } from "viewer/data.js";
import { asText, copy } from "viewer/copy.js";
import {
  budgets,
  chosen,
  device,
  difference,
  FILTERS,
  metric,
  rows,
  scope,
  scopes,
  score,
  texts,
  time,
} from "viewer/table_rows.js";

const COLUMNS = [
  ["method", "method", true],
  ["target_spp", "spp", true],
  ["mean", "score", false],
  ["difference", "to the best", false],
  ["inference_ms", "inference ms", true],
  ["frame_ms", "frame ms", true],
  ["verdict", "", true],
]; // key, title, smallest first
export function tableView() {
  if (!device().table.metrics.length) {
    return { element: h("p", { class: "hint" }, "no scores"), update() {} };
  }
  const controls = [
    select(
      "scene",
      () => scopes().map((name) => [name, name === "all" ? "mean over scenes" : name]),
      scope,
      (value) => set({ scope: value }),
    ),
    select(
      "budget",
      () => [["", "all"], ...budgets().map((spp) => [spp, `${spp} spp`])],
      () => state.tspp,
      (tspp) => set({ tspp }),
    ),
    select(
      "score",
      () => device().table.metrics.map((each) => [each.metric, each.title]),
      () => metric().metric,
      (value) => set({ metric: value }),
    ),
  ];
  if (data.devices.length > 1)
    controls.push(
      select(
        "device",
        () => data.devices.map((each, i) => [i, each.place]),
        () => state.device,
        (value) => set({ device: Number(value) }),
      ),
    );
  const search = h("input", {
    type: "search",
    "aria-label": "name contains",
    placeholder: "name contains",
    oninput: () => set({ search: search.value }),
  });
  const filters = Object.keys(FILTERS).map((name) =>
    h("button", { type: "button", "data-filter": name, onclick: () => toggle(name) }, name),
  );
  const formats = ["markdown", "latex", "csv"].map((format) =>
    h(
      "button",
      { type: "button", "data-copy": format, onclick: () => copyTable(format) },
      `Copy ${format === "latex" ? "LaTeX" : format === "csv" ? "CSV" : "Markdown"}`,
    ),
  );
  const link = h(
    "button",
    { type: "button", "data-copy": "link", onclick: () => put(permalink(), "link") },
    "Copy link",
  );
  const copied = h("textarea", {
    readonly: true,
    hidden: true,
    rows: 6,
    "aria-label": "copied text",
  });
  const status = h("span", { role: "status", class: "hint" });
  const table = h("div", { class: "scroll" });
  const notes = h("div", { class: "hint" });
  const put = async (text, name) => {
    copied.value = text;
    copied.hidden = false;
    status.textContent = (await copy(text))
      ? `${name} is in the clipboard`
      : `${name} is below; the browser does not let pages copy`;
  };
  const copyTable = (format) => put(asText(texts(rows()), format), format);
  const update = () => {
    controls.forEach((each) => each.update());
    if (search.value !== state.search) search.value = state.search;
    filters.forEach((button) =>
      button.setAttribute("aria-pressed", String(chosen().includes(button.dataset.filter))),
    );
    table.replaceChildren(draw(rows()));
    notes.replaceChildren(
      h(
        "p",
        {},
        `${metric().title}: ${metric().convention}. Bars: interval of the paired difference to the best at its budget. ${data.verdict_note} ±: how far a quiet machine's time may be from it. Frame time: G-buffer + inference + samples.`,
      ),
      h(
        "details",
        { hidden: !device().table.notes.length },
        h("summary", {}, `${device().table.notes.length} note${device().table.notes.length === 1 ? "" : "s"} on the rows`),
        h(
          "ul",
          {},
          device().table.notes.map((note) => h("li", {}, note)),
        ),
      ),
    );
  };
  const element = h(
    "section",
    {},
    h(
      "div",
      { class: "toolbar" },
      controls.map((each) => each.element),
      search,
    ),
    h("div", { class: "methods", role: "group", "aria-label": "filters by traits" }, filters),
    h("div", { class: "methods" }, formats, link, status),
    copied,
    table,
    notes,
  );
  return { element, update };
}

function toggle(name) {
  const now = chosen();
  set({
    filter: (now.includes(name) ? now.filter((each) => each !== name) : [...now, name]).join(","),
  });
}

function draw(shown) {
  const head = COLUMNS.map(([key, title, up]) => {
    const isSorted = state.sort === key;
    const next = { sort: key, up: isSorted ? 1 - state.up : Number(up) };
    const direction = isSorted ? (state.up ? "ascending" : "descending") : "none";
    return h(
      "th",
      { scope: "col", "aria-sort": direction },
      h(
        "button",
        { type: "button", "data-sort": key, onclick: () => set(next) },
        title || "verdict",
        isSorted ? (state.up ? " ▲" : " ▼") : "",
      ),
    );
  });
  head.splice(4, 0, h("th", { scope: "col" }, "interval"));
  const reach = scale(shown);
  const body = shown.map((row) =>
    h(
      "tr",
      { "data-row": row.method, class: row.best ? "is-best" : "" },
      h("th", { scope: "row" }, named(row.method)),
      h("td", {}, short(row.target_spp)),
      h("td", {}, score(row.mean)),
      h("td", {}, difference(row)),
      h("td", {}, bar(row, reach)),
      h("td", {}, time(row, "inference")),
      h("td", {}, time(row, "frame")),
      h("td", {}, row.verdict + row.mark),
    ),
  );
  return h(
    "table",
    { class: "results" },
    h("caption", {}, `${shown.length} rows`),
    h("thead", {}, h("tr", {}, head)),
    h("tbody", {}, body),
  );
}

function named(method) {
  const lines = { ...data.provenance[method] };
  const traits = data.traits[method] ?? {};
  if (traits.paper)
    Object.assign(lines, { paper: traits.paper, inputs: traits.inputs.join(", ") || "none" });
  return h(
    "span",
    { class: "named", tabindex: traits.page ? null : 0 },
    traits.page ? h("a", { href: traits.page }, method) : method,
    h(
      "span",
      { class: "provenance", role: "tooltip" },
      Object.entries(lines).map(([key, text]) => h("span", {}, h("b", {}, key), ` ${text}`)),
    ),
  );
}

/** Ends of the scale of the bars: of the rows near the best; others end at its border. */
function scale(shown) {
  const sizes = shown.map((row) => Math.abs(row.difference ?? 0)).sort((a, b) => a - b);
  const near = 4 * sizes[sizes.length >> 1];
  const ends = shown
    .filter((row) => Math.abs(row.difference ?? 0) <= near)
    .flatMap((row) => [row.low, row.high, row.difference])
    .filter((value) => Number.isFinite(value));
  return [Math.min(0, ...ends), Math.max(0, ...ends)];
}

function bar(row, [low, high]) {
  if (row.best || row.difference === null) return "";
  const x = (value) =>
    (118 * (Math.min(Math.max(value, low), high) - low)) / (high - low || 1) + 1;
  const parts = [s("line", { class: "zero", x1: x(0), x2: x(0), y1: 0, y2: 14 })];
  if (row.low !== null)
    parts.push(
      s("rect", { x: x(row.low), width: Math.max(2, x(row.high) - x(row.low)), y: 4, height: 6 }),
    );
  parts.push(
    s("line", { class: "centre", x1: x(row.difference), x2: x(row.difference), y1: 1, y2: 13 }),
  );
  return s(
    "svg",
    { width: 120, height: 14, class: "interval", role: "img", "aria-label": difference(row) },
    parts,
  );
}
