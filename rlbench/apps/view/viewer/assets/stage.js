// The stage: panes of images that move together, and the gestures on them.

import { h, s } from "viewer/dom.js";
import { set, state } from "viewer/state.js";
import { PlainRenderer } from "viewer/plain_renderer.js";
import { Renderer } from "viewer/renderer.js";
import { maps } from "viewer/data.js";

const MAX_ZOOM = 64;

export class Stage {
  constructor() {
    this.remarks = []; // on what the browser lacks
    try {
      this.renderer = new Renderer(maps);
    } catch (error) {
      this.renderer = new PlainRenderer(maps);
      this.remarks.push(`Images are drawn without WebGL2, more slowly: ${error.message}.`);
    }
    this.canvas = this.renderer.canvas;
    this.grid = h("div", { class: "panes" });
    this.element = h(
      "div",
      { class: "stage", tabindex: 0, role: "application", "aria-label": "images" },
      this.canvas,
      this.grid,
    );
    this.panes = [];
    this.pointers = new Map();
    new ResizeObserver(() => this.draw()).observe(this.element);
    this.#listen();
  }

  /** Show panes of a clip: {label, image, reference?, other?: promises, look}; `gesture` is what a
   * drag does: split, pan or line; `line` gives the ends of the line, x0, y0, x1, y1. */
  show(clip, panes, gesture, line = null) {
    Object.assign(this, { clip, panes, gesture, line });
    this.element.dataset.gesture = gesture;
    const boxes = panes.map((pane) =>
      h(
        "figure",
        { class: "pane", "data-pane": pane.label },
        h("figcaption", {}, pane.label),
        s("svg", { class: "overlay" }),
      ),
    );
    this.grid.replaceChildren(...boxes);
    this.draw();
  }

  /** Zoom and centre as they are shown. */
  view() {
    const box = this.grid.firstElementChild?.getBoundingClientRect() ?? { width: 1, height: 1 };
    const { width, height } = this.clip;
    const fit = Math.min(box.width / width, box.height / height);
    return {
      zoom: state.zoom || fit,
      fit,
      x: state.x < 0 ? width / 2 : state.x,
      y: state.y < 0 ? height / 2 : state.y,
    };
  }

  draw() {
    if (!this.panes.length || !this.element.isConnected) return;
    cancelAnimationFrame(this.due);
    this.due = requestAnimationFrame(() => this.#draw());
  }

  /** Zoom by a factor; the image pixel at (x, y) stays where it is. */
  zoomBy(factor, at = this.view()) {
    const view = this.view();
    const zoom = Math.min(Math.max(view.zoom * factor, view.fit / 4), MAX_ZOOM);
    const share = 1 - view.zoom / zoom;
    set({ zoom, x: view.x + (at.x - view.x) * share, y: view.y + (at.y - view.y) * share });
  }

  /** Move the centre by image pixels. */
  panBy(dx, dy) {
    const view = this.view();
    const clamp = (value, size) => Math.min(Math.max(value, 0), size);
    set({
      zoom: view.zoom,
      x: clamp(view.x + dx, this.clip.width),
      y: clamp(view.y + dy, this.clip.height),
    });
  }

  /** As many columns as make the images largest. */
  #columns() {
    const { clientWidth, clientHeight } = this.grid;
    const fit = (columns) =>
      Math.min(
        clientWidth / columns / this.clip.width,
        clientHeight / Math.ceil(this.panes.length / columns) / this.clip.height,
      );
    return this.panes
      .map((_, i) => i + 1)
      .reduce((best, columns) => (fit(columns) > fit(best) ? columns : best));
  }

  #draw() {
    const missing = new Set();
    this.grid.style.setProperty("--columns", this.#columns());
    const view = this.view();
    const origin = this.canvas.getBoundingClientRect();
    this.renderer.begin();
    this.panes.forEach((pane, index) => {
      const figure = this.grid.children[index];
      const box = figure.getBoundingClientRect();
      const images = {};
      for (const name of ["image", "reference", "other"]) {
        if (!pane[name]) continue;
        if (pane[name].image) images[name] = pane[name].image;
        else missing.add(pane[name]);
      }
      if (images.image && (!pane.other || images.other) && (!pane.reference || images.reference)) {
        const place = {
          x: box.x - origin.x,
          y: box.y - origin.y,
          width: box.width,
          height: box.height,
        };
        this.renderer.draw(place, images, view, pane.look);
      }
      this.#mark(figure.querySelector("svg"), box, view);
    });
    this.element.setAttribute("aria-busy", String(missing.size > 0));
    missing.forEach((promise) => promise.then(() => this.draw()));
  }

  #mark(svg, box, view) {
    const px = (x) => (x - view.x) * view.zoom + box.width / 2;
    const py = (y) => (y - view.y) * view.zoom + box.height / 2;
    const marks = [];
    if (state.px >= 0 && view.zoom >= 3) {
      const place = { x: px(state.px), y: py(state.py), width: view.zoom, height: view.zoom };
      marks.push(s("rect", { ...place, class: "halo" }), s("rect", place));
    }
    if (this.line) {
      const [x1, y1, x2, y2] = this.line().map((value, i) => (i % 2 ? py : px)(value + 0.5));
      marks.push(s("line", { x1, y1, x2, y2, class: "halo" }), s("line", { x1, y1, x2, y2 }));
    }
    svg.replaceChildren(...marks);
  }

  /** Image pixels at a pointer, and the share of its pane's width; null outside of all panes. */
  #locate(event) {
    for (const figure of this.grid.children) {
      const box = figure.getBoundingClientRect();
      const [left, top] = [event.clientX - box.left, event.clientY - box.top];
      if (left < 0 || top < 0 || left > box.width || top > box.height) continue;
      const view = this.view();
      return {
        x: (left - box.width / 2) / view.zoom + view.x,
        y: (top - box.height / 2) / view.zoom + view.y,
        share: left / box.width,
      };
    }
    return null;
  }

  #pick(at) {
    const [px, py] = [Math.floor(at.x), Math.floor(at.y)];
    const isInside = px >= 0 && py >= 0 && px < this.clip.width && py < this.clip.height;
    set(isInside ? { px, py } : { px: -1, py: -1 });
  }

  #listen() {
    const { element } = this;
    element.addEventListener(
      "wheel",
      (event) => {
        const at = this.#locate(event);
        if (!at) return;
        event.preventDefault();
        this.zoomBy(2 ** (-event.deltaY / 300), at);
      },
      { passive: false },
    );
    element.addEventListener("dblclick", () => set({ zoom: 0, x: -1, y: -1, split: -1 }));
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("pointerdown", (event) => {
      const at = this.#locate(event);
      if (!at) return;
      element.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, event);
      this.from = at;
      this.isPan = event.shiftKey || event.button > 0 || this.gesture === "pan";
    });
    element.addEventListener("pointermove", (event) => this.#move(event));
    for (const name of ["pointerup", "pointercancel"]) {
      element.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    }
  }

  #move(event) {
    const at = this.#locate(event);
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      if (at) this.#pick(at);
      return;
    }
    this.pointers.set(event.pointerId, event);
    if (this.pointers.size === 2) return this.#pinch(before, event);
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    const { zoom } = this.view();
    if (this.isPan) this.panBy(-dx / zoom, -dy / zoom);
    else if (at && this.gesture === "split") set({ split: Number(at.share.toFixed(4)) });
    else if (at && this.gesture === "line") this.#drawLine(at);
  }

  #drawLine(at) {
    const clamp = (value, size) => Math.min(Math.max(Math.floor(value), 0), size - 1);
    const [from, to] = [this.from, at].map(
      ({ x, y }) => `${clamp(x, this.clip.width)},${clamp(y, this.clip.height)}`,
    );
    if (from !== to) set({ line: `${from},${to}` });
  }

  #pinch(before, now) {
    const [other] = [...this.pointers]
      .filter(([id]) => id !== now.pointerId)
      .map(([, event]) => event);
    const distance = (event) =>
      Math.hypot(event.clientX - other.clientX, event.clientY - other.clientY);
    const { zoom } = this.view();
    this.panBy(
      (before.clientX - now.clientX) / 2 / zoom,
      (before.clientY - now.clientY) / 2 / zoom,
    );
    if (distance(before) > 0) this.zoomBy(distance(now) / distance(before));
  }
}
