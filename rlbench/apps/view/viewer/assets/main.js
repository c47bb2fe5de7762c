// The page: five views, the hash of the address, and keys.

import { h } from "viewer/dom.js";
import { set, start, state, subscribe } from "viewer/state.js";
import { data, isGallery } from "viewer/data.js";
import { clip, settle, Workspace } from "viewer/workspace.js";
import { decideView } from "viewer/decide_view.js";
import { tableView } from "viewer/table_view.js";
import { fillHelp, listen, VIEWS } from "viewer/keys.js";
import * as flip from "viewer/flip_view.js";
import * as layers from "viewer/layers_view.js";
import * as time from "viewer/time_view.js";

const MODES = { flip, layers, time };
const LOOK = ["clip", "spp", "a", "b", "show", "split", "frame", "layer", "ev", "curve", "range"]; // that change panes

start({ view: data.devices[0]?.decide.length ? "decide" : "table", ...data.question });

const hasImages = clip() !== null;
if (hasImages) settle();
settleView();

const workspace = hasImages ? new Workspace() : null;
const modes = {};
let entered = ""; // the view that the page shows
const pages = isGallery ? {} : { decide: decideView(), table: tableView() };
const views = document.getElementById("views");
const tabs = VIEWS.map(([name, title]) =>
  h(
    "button",
    {
      type: "button",
      role: "tab",
      id: `tab-${name}`,
      "aria-controls": "views",
      onclick: () => set({ view: name }),
    },
    title,
  ),
);
document.getElementById("tabs").append(...tabs);
views.setAttribute("role", "tabpanel");
const rounding = h("li", {}, roundingText());
const remarks = [...data.remarks, ...(workspace?.stage.remarks ?? [])];
document.getElementById("remarks").append(...remarks.map((text) => h("li", {}, text)), rounding);

const help = document.getElementById("help");
fillHelp(help);
document.getElementById("help-button").addEventListener("click", () => help.showModal());
listen(workspace, help);

subscribe((changed) => {
  settleView();
  if (hasImages && ["clip", "spp", "a", "b", "frame"].some((key) => changed.has(key))) settle();
  show(changed);
});
show(new Set());
window.addEventListener("resize", () => pages[state.view]?.update());

/** A view that the page has; an address may name another one. */
function settleView() {
  if (!VIEWS.some(([name]) => name === state.view)) set({ view: VIEWS[0][0] });
}

function show(changed) {
  tabs.forEach((tab) => {
    const isShown = tab.id === `tab-${state.view}`;
    tab.setAttribute("aria-selected", String(isShown));
    tab.tabIndex = isShown ? 0 : -1;
  });
  rounding.hidden = state.view in pages || !rounding.textContent;
  if (state.view in pages) {
    workspace?.play(false);
    if (entered !== state.view) views.replaceChildren(pages[state.view].element);
    entered = state.view;
    pages[state.view].update();
    return;
  }
  const isNew = entered !== state.view;
  if (isNew) enter(state.view);
  const mode = MODES[state.view];
  workspace.update();
  modes[state.view].update();
  if (isNew || LOOK.some((key) => changed.has(key))) arrange(mode);
  else workspace.stage.draw();
}

function enter(name) {
  entered = name;
  modes[name] ??= MODES[name].extras();
  const { bar, stage, readout } = workspace;
  const isBelow = name === "time";
  const side = h("div", { class: `work ${name}` }, stage.element, readout);
  views.replaceChildren(
    h("section", {}, bar, ...(isBelow ? [side, modes[name].element] : [modes[name].element, side])),
  );
}

/** Show the panes of a view; where a scale has to be measured first, once more after it. */
function arrange(mode) {
  const put = () => workspace.stage.show(clip(), mode.panes(), mode.gesture, mode.sliceLine);
  put();
  if (mode === layers) layers.rangeOf(layers.chosenLayer(), () => MODES[state.view] === mode && put());
}

function roundingText() {
  const error = data.relative_error;
  if (!error) return "";
  return `Images are rounded: a value is within ${(100 * error).toPrecision(2)} % (near black within ${(error / 128).toPrecision(1)} of display white).`;
}

for (const tab of tabs) {
  tab.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.stopPropagation();
    const next = tabs[(tabs.indexOf(tab) + step + tabs.length) % tabs.length];
    next.click();
    next.focus();
  });
}
document.documentElement.dataset.ready = "true";
