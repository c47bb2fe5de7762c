// From linear radiance to what a display shows; `renderer.js` has the same in GLSL.

export const CURVES = [
  ["srgb", "clipped sRGB"],
  ["reinhard", "Reinhard 2002"],
  ["hable", "Hable 2010"],
];

/** sRGB of a linear value, clipped to [0, 1] (IEC 61966-2-1). */
export function srgb(value) {
  const v = Math.min(Math.max(value, 0), 1);
  return v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055;
}

function filmic(v) {
  return (v * (0.15 * v + 0.05) + 0.004) / (v * (0.15 * v + 0.5) + 0.06) - 1 / 15;
}

const APPLY = {
  srgb: (v) => v,
  reinhard: (v) => v / (1 + v), // Photographic Tone Reproduction, equation 3
  hable: (v) => filmic(2 * v) / filmic(11.2), // Filmic Tonemapping Operators
};

/** A display value in [0, 1] of linear radiance at an exposure in stops. */
export function tone(value, exposure, curve) {
  return srgb(APPLY[curve](Math.max(value * 2 ** exposure, 0)));
}
