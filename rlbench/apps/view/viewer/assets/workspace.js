// What the views of images share: clip, budget, exposure, frame, the stage, and values of a pixel.

import { h, select, short, slider } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { CURVES, srgb } from "viewer/tone.js";
import { isGallery } from "viewer/data.js";
import { clips } from "viewer/pictures.js";
import { Stage } from "viewer/stage.js";

const RATES = [24, 12, 6, 3, 1]; // frames a second

/** The clip that is shown, or null where the page has no images. */
export function clip() {
  return clips.length ? clips[Math.min(state.clip, clips.length - 1)]() : null;
}

/** Methods with images of the clip at the budget, the best first. */
export function methods() {
  return clip()?.methods(state.spp) ?? [];
}

/** What images are compared with: the reference, or among image files method A. */
export function truth() {
  return isGallery ? state.a : "reference";
}

/** All that a pane can show, the reference first. */
export function sources() {
  return isGallery ? methods() : ["reference", ...methods()];
}

/** The clip, budget, frame and methods of the state, put right where the clip does not have them. */
export function settle() {
  const now = clip();
  if (!now) return;
  const spp = now.budgets.includes(state.spp) ? state.spp : now.budgets[0];
  const names = now.methods(spp);
  const a = names.includes(state.a) ? state.a : names[0];
  const b =
    names.includes(state.b) && state.b !== a ? state.b : (names.find((name) => name !== a) ?? a);
  const show = isGallery && state.show === "ref" ? "a" : state.show;
  set({ spp, a, b, show, frame: Math.min(Math.max(0, state.frame), now.frames - 1) });
}

/** Promise of an image of the clip at the present budget and frame. */
export function picture(source, kind = "image", frame = state.frame) {
  return clip().picture(source, state.spp, frame, kind, truth());
}

/** How the stage shows the image itself: tone curve and exposure of the state, no split. */
export function imageLook() {
  const { curve, ev } = state;
  return { layer: "image", curve, ev, range: [0, 1], map: "magma", split: -1 };
}

export class Workspace {
  constructor() {
    this.stage = new Stage();
    const stops = { min: -8, max: 8, step: 0.25 };
    const ofClips = [
      select(
        "clip",
        () => clips.map((each, i) => [i, each().name]),
        () => state.clip,
        (value) => set({ clip: Number(value), zoom: 0, x: -1, y: -1, px: -1, py: -1, line: "" }),
      ),
      select(
        "budget",
        () => clip().budgets.map((spp) => [spp, `${spp} spp`]),
        () => state.spp,
        (value) => set({ spp: Number(value) }),
      ),
    ];
    const ofImages = [
      slider(
        "exposure",
        stops,
        () => state.ev,
        (ev) => set({ ev }),
        (ev) => `${ev > 0 ? "+" : ""}${ev} EV`,
      ),
      select(
        "tone curve",
        () => CURVES,
        () => state.curve,
        (curve) => set({ curve }),
      ),
    ];
    this.scrubber = slider(
      "frame",
      { min: 0, step: 1 },
      () => state.frame,
      (frame) => set({ frame }),
      (frame) => `${frame}`,
    );
    this.controls = isGallery ? ofImages : [...ofClips, ...ofImages, this.scrubber];
    this.rate = h(
      "select",
      { "aria-label": "frames a second" },
      RATES.map((rate) => h("option", { value: rate }, `${rate} fps`)),
    );
    this.rate.value = "6";
    this.playButton = h(
      "button",
      { type: "button", id: "play", onclick: () => this.play(!this.timer) },
      "Play",
    );
    this.rate.addEventListener("change", () => this.timer && this.play(true));
    this.readout = h("div", { class: "readout", "aria-live": "off" });
    this.bar = h(
      "div",
      { class: "toolbar" },
      this.controls.map((each) => each.element),
      isGallery ? null : h("span", { class: "field" }, this.playButton, this.rate),
    );
  }

  /** Play or stop. */
  play(isPlaying) {
    clearInterval(this.timer);
    this.timer = isPlaying
      ? setInterval(
          () => set({ frame: (state.frame + 1) % clip().frames }),
          1000 / Number(this.rate.value),
        )
      : 0;
    this.playButton.textContent = isPlaying ? "Stop" : "Play";
    this.playButton.setAttribute("aria-pressed", String(isPlaying));
  }

  update() {
    this.scrubber.input.max = clip().frames - 1;
    this.controls.forEach((each) => each.update());
    this.#listValues();
  }

  async #listValues() {
    const { px, py, frame } = state;
    if (px < 0) {
      this.readout.replaceChildren(
        h(
          "p",
          { class: "hint" },
          "Point at a pixel, or move with the arrow keys, for its values in all images.",
        ),
      );
      return;
    }
    const now = clip();
    const names = sources();
    const base = truth();
    const at = (image) => image.planes.map((plane) => plane[py * now.width + px]);
    const valuesOf = async (all, kind) =>
      (await Promise.all(all.map((name) => picture(name, kind)))).map(at);
    const counted = isGallery ? [] : methods();
    const [values, counts, buffers] = await Promise.all([
      valuesOf(names),
      valuesOf(counted, "counts"),
      valuesOf(now.buffersPresent),
    ]);
    const isNow = px === state.px && py === state.py && frame === state.frame;
    if (!isNow || base !== truth()) return; // it has moved on
    const expected = values[names.indexOf(base)];
    const row = (name, i) => {
      const errors = values[i].map((value, c) => srgb(value) - srgb(expected[c]));
      const error = errors.reduce((sum, each) => sum + each, 0) / 3;
      const [count] = counts[counted.indexOf(name)] ?? [];
      return h(
        "tr",
        { "data-row": name },
        h("th", { scope: "row" }, name),
        values[i].map((value) => h("td", {}, short(value))),
        h("td", {}, name === base ? "" : short(error, 2)),
        isGallery ? null : h("td", {}, count === undefined ? "" : short(count)),
      );
    };
    const columns = ["", "R", "G", "B", ...(isGallery ? ["minus A"] : ["error", "samples"])];
    const meaning = `R, G, B: linear radiance; ${columns[4]}: mean over channels of clipped sRGB`;
    this.readout.replaceChildren(
      h(
        "table",
        {},
        h("caption", {}, `pixel ${px}, ${py}${isGallery ? "" : ` of frame ${frame}`}`),
        h("thead", {}, h("tr", {}, columns.map((text) => h("th", { scope: "col" }, text)))),
        h("tbody", {}, names.map(row)),
      ),
      h(
        "p",
        { class: "hint" },
        [
          ...now.buffersPresent.map(
            (name, i) => `${name} ${buffers[i].map((value) => short(value, 2)).join(", ")}`,
          ),
          meaning,
        ].join("; "),
      ),
    );
  }
}
