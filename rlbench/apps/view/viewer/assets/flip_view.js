// Flip: methods in place of each other, two beside a split, or all of them.

import { h } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { isGallery } from "viewer/data.js";
import { imageLook, methods, picture, sources } from "viewer/workspace.js";

export const gesture = "split";

export function extras() {
  const buttons = h("div", { class: "methods", role: "group", "aria-label": "methods" });
  const update = () => {
    const names = methods();
    buttons.replaceChildren(
      ...names.map((name, i) =>
        h(
          "button",
          {
            type: "button",
            class: role(name),
            "aria-pressed": String(state.show !== "all" && shown() === name),
            "data-method": name,
            onclick: (event) => (event.shiftKey ? compareWith(name) : showMethod(name)),
          },
          i < 9 ? h("kbd", {}, i + 1) : null,
          ` ${name}`,
        ),
      ),
      ...toggles(names.length),
    );
  };
  return { element: buttons, update };
}

/** Buttons of what is shown beside a single method; a single image file has none. */
function toggles(count) {
  const toggle = (key, text, onclick, isPressed = null, more = {}) =>
    h(
      "button",
      { type: "button", "aria-pressed": isPressed?.toString(), onclick, ...more },
      h("kbd", {}, key),
      ` ${text}`,
    );
  const name = { "data-method": "reference" };
  const all = [
    toggle("G", "all", toggleAll, state.show === "all"),
    toggle("space", `blink ${state.a} / ${state.b}`, blink),
    toggle("S", "split", toggleSplit, state.split >= 0),
  ];
  if (isGallery) return count > 1 ? all : [];
  return [toggle("R", "reference", toggleReference, state.show === "ref", name), ...all];
}

export function panes() {
  const look = imageLook();
  const pane = (name) => ({ label: name, image: picture(name), look });
  if (state.show === "all") return sources().map(pane);
  sources().forEach((name) => picture(name)); // so that keys answer at once
  if (state.split < 0) return [pane(shown())];
  const [left, right] = state.show === "ref" ? [state.a, "reference"] : [state.a, state.b];
  return [
    {
      label: `${left} | ${right}`,
      image: picture(left),
      other: picture(right),
      look: { ...look, split: state.split },
    },
  ];
}

/** What the single pane shows. */
export function shown() {
  return state.show === "ref" ? "reference" : state.show === "b" ? state.b : state.a;
}

/** Method A becomes `name`; the method that was A becomes B. */
export function showMethod(name) {
  if (name) set(name === state.a ? { show: "a" } : { a: name, b: state.a, show: "a" });
}

/** Method B becomes `name`. */
export function compareWith(name) {
  if (name && name !== state.a) set({ b: name });
}

export const blink = () => set({ show: state.show === "a" ? "b" : "a", split: -1 });
export const toggleReference = () => set({ show: state.show === "ref" ? "a" : "ref" });
export const toggleAll = () => set({ show: state.show === "all" ? "a" : "all" });
export const toggleSplit = () =>
  set({ split: state.split < 0 ? 0.5 : -1, ...(state.show === "all" && { show: "a" }) });

function role(name) {
  return name === state.a ? "is-a" : name === state.b ? "is-b" : "";
}
