// Draws images without WebGL2: the layers of `renderer.js`, computed pixel by pixel.

import { fitCanvas, makeCanvas } from "viewer/renderer.js";
import { srgb, tone } from "viewer/tone.js";

const NOT_FINITE = [1, 0, 1];
const NO_DEPTH = [0.5, 0.5, 0.5];

/** Layers that are colours: of the values of a pixel. */
const COLOURS = {
  image: (value, look) => value.map((each) => tone(each, look.ev, look.curve)),
  albedo: (value) => value.map(srgb),
  normal: (value) => value.map((each) => each / 2 + 0.5),
};

/** Layers that are numbers, which a colour map shows: of the values of a pixel and of the truth. */
const NUMBERS = {
  signed: (value, truth) => differences(value, truth).reduce((sum, each) => sum + each / 3, 0),
  squared: (value, truth) =>
    differences(value, truth).reduce((sum, each) => sum + each ** 2 / 3, 0),
  scalar: ([value]) => value,
  depth: ([value]) => Math.log2(value),
  motion: ([x, y]) => Math.hypot(x, y),
};

function differences(value, truth) {
  return value.map((each, c) => srgb(each) - srgb(truth[c] || 0));
}

export class PlainRenderer {
  constructor(maps) {
    this.canvas = makeCanvas();
    this.context = this.canvas.getContext("2d");
    this.maps = maps;
    this.painted = new WeakMap(); // by image: how it was painted last
  }

  /** Clear the canvas and fit its size to its element, in device pixels. */
  begin() {
    this.scale = fitCanvas(this.canvas);
    this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
  }

  /** Draw one pane: `box` in CSS pixels of the canvas, images as decoded, `view` = {zoom, x, y}. */
  draw(box, images, view, look) {
    const { context, scale } = this;
    const [x, y, width, height] = [box.x, box.y, box.width, box.height].map((n) =>
      Math.round(n * scale),
    );
    const zoom = view.zoom * scale;
    const edge = look.split < 0 ? width : look.split * width;
    const copy = (image, left, right) => {
      context.save();
      context.beginPath();
      context.rect(x + left, y, right - left, height);
      context.clip();
      context.imageSmoothingEnabled = false;
      const place = [x + width / 2 - view.x * zoom, y + height / 2 - view.y * zoom];
      const size = [image.width * zoom, image.height * zoom];
      context.drawImage(this.#paint(image, images.reference, look), ...place, ...size);
      context.restore();
    };
    copy(images.image, 0, edge);
    if (look.split < 0) return;
    copy(images.other, edge, width);
    context.fillStyle = "white";
    context.fillRect(x + edge - 1, y, 2, height);
  }

  /** A canvas with the pixels of an image as a layer shows them. */
  #paint(image, reference, look) {
    const { layer, ev, curve, range, map } = look;
    const key = [layer, ev, curve, range, map].join("|");
    const known = this.painted.get(image);
    if (known?.key === key && known.reference === reference) return known.canvas;
    const canvas = new OffscreenCanvas(image.width, image.height);
    const pixels = new ImageData(image.width, image.height);
    for (let i = 0; i < image.width * image.height; i++) {
      const value = image.planes.map((plane) => plane[i]);
      const truth = reference?.planes.map((plane) => plane[i]);
      const colour = this.#colour(value, truth, look);
      for (let c = 0; c < 3; c++) pixels.data[4 * i + c] = 255 * colour[c];
      pixels.data[4 * i + 3] = 255;
    }
    canvas.getContext("2d").putImageData(pixels, 0, 0);
    this.painted.set(image, { key, reference, canvas });
    return canvas;
  }

  /** The colour of a pixel, RGB in [0, 1]. */
  #colour(value, truth, look) {
    if (!value.every(Number.isFinite)) return look.layer === "depth" ? NO_DEPTH : NOT_FINITE;
    if (look.layer in COLOURS) return COLOURS[look.layer](value, look);
    const [from, to] = look.range;
    const share = (NUMBERS[look.layer](value, truth) - from) / (to - from);
    const index = 3 * Math.floor(Math.min(Math.max(share, 0), 1) * 255 + 0.5);
    return [...this.maps[look.map].subarray(index, index + 3)].map((each) => each / 255);
  }
}
