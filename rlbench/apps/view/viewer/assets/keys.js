// Keys of the page.

import { h } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { isGallery } from "viewer/data.js";
import { clip, methods } from "viewer/workspace.js";
import { CURVES } from "viewer/tone.js";
import * as flip from "viewer/flip_view.js";

const IMAGE_VIEWS = ["flip", "layers", "time"];

/** The views of this page: name, title, key. */
export const VIEWS = [
  ["decide", "Decide", "d"],
  ["flip", "Flip", "f"],
  ["layers", "Layers", "l"],
  ["time", "Time", "t"],
  ["table", "Table", "b"],
].filter(([name]) =>
  isGallery ? ["flip", "layers"].includes(name) : clip() || !IMAGE_VIEWS.includes(name),
);

const HELP = [
  [
    VIEWS.map(([, , key]) => key).join(" "),
    `views ${VIEWS.map(([, title]) => title).join(", ")}`,
  ],
  ["1 to 9", isGallery ? "image A; with shift, image B" : "method A; with shift, method B"],
  ["space", "blink between A and B"],
  ["G", isGallery ? "all images" : "all methods"],
  ["S", "split A and B; [ and ] move it, and so does a drag"],
  ["E, shift E", "exposure up, down"],
  ["C", "next tone curve"],
  ["+ - 0", "zoom in, out, fit; so does the wheel"],
  [
    "arrows",
    "pixel whose values are listed; with shift, move the image, and so does a drag with shift",
  ],
];
const HELP_ON_CLIPS = [
  ["R", "reference and back"],
  [", and .", "frame before, after"],
  ["P", "play and stop"],
  ["X, Y", "slice through time along the row or column of the listed pixel; so does a drag"],
];

export function fillHelp(dialog) {
  dialog.replaceChildren(
    h("h2", {}, "Keys"),
    h(
      "dl",
      {},
      [...HELP, ...(isGallery ? [] : HELP_ON_CLIPS)].map(([key, text]) => [h("dt", {}, h("kbd", {}, key)), h("dd", {}, text)]),
    ),
    h("form", { method: "dialog" }, h("button", {}, "Close")),
  );
}

/** Act on keys; those that a control of the page uses itself are left to it. */
export function listen(workspace, dialog) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || dialog.open) return;
    const { target } = event;
    if (target.matches("input[type=search], textarea, select")) return;
    if (target.matches("input[type=range]") && /^(Arrow|Home|End|Page)/.test(event.key)) return;
    if (target.matches("button") && (event.key === " " || event.key === "Enter")) return;
    if (act(event, workspace, dialog)) event.preventDefault();
  });
}

function act(event, workspace, dialog) {
  const { key, code, shiftKey } = event;
  if (key === "?") return dialog.showModal() ?? true;
  const view = VIEWS.find((each) => each[2] === key);
  if (view) return set({ view: view[0] }) ?? true;
  if (!IMAGE_VIEWS.includes(state.view) || !clip()) return false;
  const digit = /^Digit([1-9])$/.exec(code)?.[1] ?? (/^[1-9]$/.test(key) ? key : null);
  if (digit) return (shiftKey ? flip.compareWith : flip.showMethod)(methods()[digit - 1]) ?? true;
  const action = actions(shiftKey, workspace)[key.length === 1 ? key.toLowerCase() : key];
  if (!action) return false;
  action();
  return true;
}

function actions(shift, { stage }) {
  const step = (by) => () => set({ frame: (state.frame + by + clip().frames) % clip().frames });
  const move = (dx, dy) => () => (shift ? stage.panBy(8 * dx, 8 * dy) : movePixel(dx, dy));
  const split = (by) => () =>
    set({ split: Math.min(Math.max((state.split < 0 ? 0.5 : state.split) + by, 0), 1) });
  const curves = CURVES.map(([name]) => name);
  const onClips = {
    r: flip.toggleReference,
    ",": step(-1),
    ".": step(1),
    "<": step(-1),
    ">": step(1),
    p: () => document.getElementById("play").click(),
    x: () => set({ line: lineThrough("row") }),
    y: () => set({ line: lineThrough("column") }),
  };
  return {
    ...(isGallery ? {} : onClips),
    " ": flip.blink,
    g: flip.toggleAll,
    s: flip.toggleSplit,
    "[": split(-0.05),
    "]": split(0.05),
    e: () => set({ ev: Math.min(Math.max(state.ev + (shift ? -0.5 : 0.5), -8), 8) }),
    c: () => set({ curve: curves[(curves.indexOf(state.curve) + 1) % curves.length] }),
    "+": () => stage.zoomBy(1.5),
    "=": () => stage.zoomBy(1.5),
    "-": () => stage.zoomBy(1 / 1.5),
    0: () => set({ zoom: 0, x: -1, y: -1 }),
    ArrowLeft: move(-1, 0),
    ArrowRight: move(1, 0),
    ArrowUp: move(0, -1),
    ArrowDown: move(0, 1),
  };
}

/** Ends of the row or column of the listed pixel, or of the middle. */
function lineThrough(direction) {
  const { width, height } = clip();
  const [x, y] = state.px < 0 ? [width >> 1, height >> 1] : [state.px, state.py];
  return (direction === "row" ? [0, y, width - 1, y] : [x, 0, x, height - 1]).join(",");
}

function movePixel(dx, dy) {
  const { width, height } = clip();
  const from = state.px < 0 ? [width >> 1, height >> 1] : [state.px + dx, state.py + dy];
  set({
    px: Math.min(Math.max(from[0], 0), width - 1),
    py: Math.min(Math.max(from[1], 0), height - 1),
  });
}
