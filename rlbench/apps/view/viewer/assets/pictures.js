// The images of the page, decoded when they are first shown.

import { decode } from "viewer/tiles.js";
import { flipMap } from "viewer/flip_map.js";

const LIMIT = 400; // decoded images that are kept

/** Layers that belong to a clip rather than to a method. */
export const BUFFERS = ["albedo", "normal", "depth", "motion"];

class Clip {
  constructor(element) {
    Object.assign(this, JSON.parse(element.textContent));
    this.cache = new Map();
  }

  /** Budgets of the images, ascending. */
  get budgets() {
    return [...new Set(this.images.map((each) => each.spp))].sort((a, b) => a - b);
  }

  /** Names of the methods with images at a budget, best first. */
  methods(spp) {
    return this.images.filter((each) => each.spp === spp).map((each) => each.method);
  }

  /** Layers of the clip besides those that every clip has. */
  get buffersPresent() {
    return BUFFERS.filter((name) => name in this.buffers);
  }

  /** The promise of an image: source is a method, "reference" or a buffer; kind: image, counts,
   * or flip, which compares with the source `truth`. */
  picture(source, spp, frame, kind = "image", truth = "reference") {
    const key = [source, spp, frame, kind, kind === "flip" ? truth : ""].join("|");
    const known = this.cache.get(key);
    if (known) this.cache.delete(key); // to the end of the order
    const promise =
      known ?? this.#read(source, spp, frame, kind, truth).then((image) => (promise.image = image));
    this.cache.set(key, promise);
    if (this.cache.size > LIMIT) this.cache.delete(this.cache.keys().next().value);
    return promise;
  }

  async #read(source, spp, frame, kind, truth) {
    if (kind === "flip") {
      const images = [source, truth].map((name) => this.picture(name, spp, frame));
      return flipMap(...(await Promise.all(images)));
    }
    if (source === "reference") return decode(this.reference[frame]);
    if (source in this.buffers) return decode(this.buffers[source][frame]);
    const images = this.images.find((each) => each.method === source && each.spp === spp);
    return decode((kind === "counts" ? images.counts : images.frames)[frame]);
  }
}

export const clips = [...document.querySelectorAll("script.clip")].map((element) => {
  let clip = null; // parsed when it is first asked for
  return () => (clip ??= new Clip(element));
});
