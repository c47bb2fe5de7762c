// Draws images with WebGL2 (`plain_renderer.js` without it): tone curves on linear radiance, errors and other layers by colour maps.

import { h } from "viewer/dom.js";

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
uniform sampler2D image, reference, other, colours;
uniform vec2 origin, extent, size, centre;
uniform float zoom, exposure, split;
uniform int layer, curve;
uniform vec2 range;
out vec4 colour;

vec3 srgb(vec3 linear) {
  vec3 v = clamp(linear, 0.0, 1.0);
  return mix(1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, 12.92 * v, vec3(lessThanEqual(v, vec3(0.0031308))));
}
vec3 filmic(vec3 v) { return (v * (0.15 * v + 0.05) + 0.004) / (v * (0.15 * v + 0.5) + 0.06) - 1.0 / 15.0; }
vec3 tone(vec3 radiance) {
  vec3 v = max(radiance * exp2(exposure), 0.0);
  if (curve == 1) v = v / (1.0 + v);
  if (curve == 2) v = filmic(2.0 * v) / filmic(vec3(11.2));
  return srgb(v);
}
vec3 map(float share) {
  return texelFetch(colours, ivec2(clamp(share, 0.0, 1.0) * 255.0 + 0.5, 0), 0).rgb;
}
vec3 shown(vec4 value, vec3 truth) {
  if (layer == 0) return tone(value.rgb);
  if (layer == 3) return srgb(value.rgb);
  if (layer == 4) return value.rgb * 0.5 + 0.5;
  float number = value.r;
  if (layer == 1) number = dot(srgb(value.rgb) - srgb(truth), vec3(1.0 / 3.0));
  if (layer == 2) { vec3 e = srgb(value.rgb) - srgb(truth); number = dot(e, e) / 3.0; }
  if (layer == 6) number = log2(number);
  if (layer == 7) number = length(value.rg);
  return map((number - range.x) / (range.y - range.x));
}
void main() {
  vec2 place = gl_FragCoord.xy - origin;
  vec2 from = (place - 0.5 * extent) * vec2(1, -1) / zoom + centre;
  ivec2 pixel = ivec2(floor(from));
  if (any(lessThan(pixel, ivec2(0))) || any(greaterThanEqual(pixel, ivec2(size)))) { colour = vec4(0); return; }
  float edge = split * extent.x;
  vec4 value = split >= 0.0 && place.x > edge ? texelFetch(other, pixel, 0) : texelFetch(image, pixel, 0);
  vec3 truth = texelFetch(reference, pixel, 0).rgb;
  colour = vec4(value.a < 0.5 ? (layer == 6 ? vec3(0.5) : vec3(1, 0, 1)) : shown(value, truth), 1);
  if (split >= 0.0 && abs(place.x - edge) < 1.0) colour = vec4(1, 1, 1, 1);
}`;

/** Numbers of the layers in the shader. */
export const LAYERS = {
  image: 0,
  signed: 1,
  squared: 2,
  albedo: 3,
  normal: 4,
  scalar: 5,
  depth: 6,
  motion: 7,
};
const CURVES = { srgb: 0, reinhard: 1, hable: 2 };
const TEXTURES = 300; // that are kept

/** A canvas for a renderer, under the panes of the stage. */
export function makeCanvas() {
  return h("canvas", { "aria-hidden": "true" });
}

/** Fit the size of a canvas to its element; returns device pixels by CSS pixel. */
export function fitCanvas(canvas) {
  const scale = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((n) =>
    Math.max(1, Math.round(n * scale)),
  );
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  return scale;
}

/** Raises an Error that says why, where the browser cannot draw with WebGL2. */
export class Renderer {
  constructor(maps) {
    this.canvas = makeCanvas();
    const gl = this.canvas.getContext("webgl2", {
      preserveDrawingBuffer: true,
      premultipliedAlpha: false,
    });
    if (!gl) throw new Error("this browser does not have it, or has it switched off");
    this.gl = gl;
    this.program = link(gl);
    gl.useProgram(this.program);
    this.uniform = (name) => gl.getUniformLocation(this.program, name);
    ["image", "reference", "other", "colours"].forEach((name, unit) =>
      gl.uniform1i(this.uniform(name), unit),
    );
    this.textures = new Map();
    this.maps = Object.fromEntries(
      Object.entries(maps).map(([name, bytes]) => [name, this.#colours(bytes)]),
    );
    gl.enable(gl.SCISSOR_TEST);
  }

  /** Clear the canvas and fit its size to its element, in device pixels. */
  begin() {
    const { gl, canvas } = this;
    this.scale = fitCanvas(canvas);
    gl.scissor(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  /** Draw one pane: `box` in CSS pixels of the canvas, images as decoded, `view` = {zoom, x, y}. */
  draw(box, images, view, look) {
    const { gl, scale, canvas } = this;
    const [x, width, height] = [box.x, box.width, box.height].map((n) => Math.round(n * scale));
    const y = canvas.height - Math.round(box.y * scale) - height;
    gl.viewport(x, y, width, height);
    gl.scissor(x, y, width, height);
    const numbers = { zoom: view.zoom * scale, exposure: look.ev, split: look.split };
    const pairs = {
      origin: [x, y],
      extent: [width, height],
      centre: [view.x, view.y],
      size: [images.image.width, images.image.height],
      range: look.range,
    };
    for (const [name, value] of Object.entries(numbers)) gl.uniform1f(this.uniform(name), value);
    for (const [name, value] of Object.entries(pairs)) gl.uniform2f(this.uniform(name), ...value);
    gl.uniform1i(this.uniform("layer"), LAYERS[look.layer]);
    gl.uniform1i(this.uniform("curve"), CURVES[look.curve]);
    const shown = [images.image, images.reference ?? images.image, images.other ?? images.image];
    const textures = [...shown.map((image) => this.#texture(image)), this.maps[look.map]]; // uploads bind unit 0
    textures.forEach((texture, unit) => this.#bind(unit, texture));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  #bind(unit, texture) {
    this.gl.activeTexture(this.gl.TEXTURE0 + unit);
    this.gl.bindTexture(this.gl.TEXTURE_2D, texture);
  }

  /** The texture of an image; alpha is 0 where a value is not finite. */
  #texture(image) {
    const known = this.textures.get(image);
    if (known) this.textures.delete(image); // to the end of the order
    const texture = known ?? this.#upload(image);
    this.textures.set(image, texture);
    if (this.textures.size > TEXTURES) {
      const [oldest, unused] = this.textures.entries().next().value;
      this.gl.deleteTexture(unused);
      this.textures.delete(oldest);
    }
    return texture;
  }

  #upload({ width, height, planes }) {
    const { gl } = this;
    const pixels = new Float32Array(4 * width * height);
    for (let i = 0; i < width * height; i++) {
      let alpha = 1;
      planes.forEach((plane, c) => {
        pixels[4 * i + c] = Math.min(Math.max(plane[i] || 0, -65504), 65504);
        if (!Number.isFinite(plane[i])) alpha = 0;
      });
      pixels[4 * i + 3] = alpha;
    }
    const texture = this.#empty();
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, width, height, 0, gl.RGBA, gl.FLOAT, pixels);
    return texture;
  }

  #colours(bytes) {
    const { gl } = this;
    const texture = this.#empty();
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, bytes);
    return texture;
  }

  #empty() {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const name of ["MIN_FILTER", "MAG_FILTER"])
      gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], gl.NEAREST);
    for (const name of ["WRAP_S", "WRAP_T"])
      gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], gl.CLAMP_TO_EDGE);
    return texture;
  }
}

function link(gl) {
  const program = gl.createProgram();
  for (const [kind, source] of [
    [gl.VERTEX_SHADER, VERTEX],
    [gl.FRAGMENT_SHADER, FRAGMENT],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS))
      throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  return program;
}
