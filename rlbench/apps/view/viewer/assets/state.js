// What the page shows now. It is in the hash of the address, so a copied link shows the same.

const DEFAULTS = {
  view: "decide",
  device: 0, // index
  metric: "psnr",
  scope: "", // of Decide and Table; empty: mean over scenes
  sample: 4.2, // cost of a sample of every pixel, ms
  deadline: 33.3, // ms
  clip: 0, // index
  spp: 1,
  a: "", // methods that are compared
  b: "",
  show: "a", // a, b, ref or all
  split: -1, // share of the width that shows A; -1: no split
  frame: 0,
  layer: "image",
  ev: 0, // exposure, stops
  curve: "srgb",
  range: 0.25, // end of the scale of errors
  zoom: 0, // screen pixels of an image pixel; 0: fit
  x: -1, // centre of what is visible, image pixels; -1: of the image
  y: -1,
  px: -1, // pixel whose values are listed
  py: -1,
  line: "", // of the x-t slice: x0,y0,x1,y1 in image pixels
  tspp: "", // budget of the table; empty: all
  sort: "mean",
  up: 0, // 1: sorted from the smallest
  filter: "", // traits, separated by commas
  search: "",
};

const listeners = [];
export const state = { ...DEFAULTS };
let pending = 0;
let known = {}; // defaults that depend on the data

/** Call `listener` with the set of changed keys, after each change. */
export function subscribe(listener) {
  listeners.push(listener);
}

/** Change the state; nothing happens where no value is new. */
export function set(changes) {
  const changed = new Set(Object.keys(changes).filter((key) => state[key] !== changes[key]));
  if (!changed.size) return;
  Object.assign(state, changes);
  clearTimeout(pending);
  pending = setTimeout(writeHash, 80); // browsers limit how often an address may change
  for (const listener of listeners) listener(changed);
}

/** Defaults that depend on the data; then the address decides. */
export function start(defaults) {
  known = { ...DEFAULTS, ...defaults };
  Object.assign(state, known, readHash());
  window.addEventListener("hashchange", () => set({ ...known, ...readHash() }));
}

/** The address of the page as it is now. */
export function permalink() {
  writeHash();
  return location.href;
}

function writeHash() {
  clearTimeout(pending);
  const words = Object.keys(known).filter((key) => state[key] !== known[key] || key === "view");
  const hash = new URLSearchParams(words.map((key) => [key, String(state[key])])).toString();
  if (`#${hash}` !== location.hash) history.replaceState(null, "", `#${hash}`);
}

function readHash() {
  const found = {};
  for (const [key, text] of new URLSearchParams(location.hash.slice(1))) {
    if (!(key in DEFAULTS)) continue;
    const value = typeof DEFAULTS[key] === "number" ? Number(text) : text;
    if (!Number.isNaN(value)) found[key] = value;
  }
  return found;
}
