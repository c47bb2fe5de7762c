// The FLIP map of two images (Andersson et al. 2020, FLIP: A Difference Evaluator for Alternating
// Images): images in clipped sRGB, for an observer at 67 pixels per degree.

const PPD = 67.02064327658226; // 0.7 m from a display 0.7 m wide with 3840 pixels
const QC = 0.7;
const PC = 0.4;
const PT = 0.95;
const QF = 0.5;
const WIDTH = 0.082; // of edges and points, degrees
const WHITE = [0.950428545, 1.0, 1.088900371]; // D65
const TO_XYZ = [
  [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
  [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
  [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
];
const CSF = [
  // of achromatic, red-green and blue-yellow: [a1, b1, a2, b2]
  [1.0, 0.0047, 0, 1e-5],
  [1.0, 0.0053, 0, 1e-5],
  [34.1, 0.04, 13.5, 0.025],
];

/** The map, one channel with values from 0 to 1. */
export function flipMap(test, reference) {
  const { width, height } = reference;
  const images = [reference, test].map((image) => toYcxcz(image.planes));
  const colour = colourDifference(...images.map((planes) => filterColour(planes, width, height)));
  const [grey, other] = images.map((planes) => planes[0].map((y) => (y + 16) / 116));
  const feature = featureDifference(grey, other, width, height);
  const map = colour.map((difference, i) => difference ** (1 - feature[i]));
  return { width, height, channels: 1, planes: [map] };
}

function toXyz(linear) {
  return TO_XYZ.map((row) => row[0] * linear[0] + row[1] * linear[1] + row[2] * linear[2]);
}

/** YCxCz of linear radiance, clipped to [0, 1] as on a display; NaN is black. */
function toYcxcz(planes) {
  const result = planes.map((plane) => new Float32Array(plane.length));
  for (let i = 0; i < planes[0].length; i++) {
    const linear = planes.map((plane) => Math.min(Math.max(plane[i] || 0, 0), 1));
    const [x, y, z] = toXyz(linear).map((value, k) => value / WHITE[k]);
    result[0][i] = 116 * y - 16;
    result[1][i] = 500 * (x - y);
    result[2][i] = 200 * (y - z);
  }
  return result;
}

const INVERSE = invert(TO_XYZ);

function fromYcxcz(y, cx, cz) {
  const luma = (y + 16) / 116;
  const xyz = [(luma + cx / 500) * WHITE[0], luma * WHITE[1], (luma - cz / 200) * WHITE[2]];
  return INVERSE.map((row) => row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2]);
}

function toHuntLab(linear) {
  const [x, y, z] = toXyz(linear.map((v) => Math.min(Math.max(v, 0), 1))).map(
    (v, k) => v / WHITE[k],
  );
  const f = (t) => (t > (6 / 29) ** 3 ? Math.cbrt(t) : t / (3 * (6 / 29) ** 2) + 4 / 29);
  const light = 116 * f(y) - 16;
  return [light, 0.01 * light * 500 * (f(x) - f(y)), 0.01 * light * 200 * (f(y) - f(z))];
}

function hyab(a, b) {
  return Math.abs(a[0] - b[0]) + Math.hypot(a[1] - b[1], a[2] - b[2]);
}

const LARGEST = hyab(toHuntLab([0, 1, 0]), toHuntLab([0, 0, 1])) ** QC;

function colourDifference(a, b) {
  const limit = PC * LARGEST;
  return Float32Array.from(a[0], (_, i) => {
    const [first, second] = [a, b].map((p) => toHuntLab(fromYcxcz(p[0][i], p[1][i], p[2][i])));
    const difference = hyab(first, second) ** QC;
    return difference < limit
      ? (difference * PT) / limit
      : PT + ((difference - limit) / (LARGEST - limit)) * (1 - PT);
  });
}

function filterColour(planes, width, height) {
  const radius = Math.ceil(3 * Math.sqrt(0.04 / (2 * Math.PI ** 2)) * PPD);
  return planes.map((plane, k) => {
    const [a1, b1, a2, b2] = CSF[k];
    const parts = [
      [a1, b1],
      [a2, b2],
    ]
      .filter(([a]) => a > 0)
      .map(([a, b]) => {
        const taps = kernel(radius, (x) => Math.exp((-(Math.PI ** 2) * (x / PPD) ** 2) / b));
        const sum = taps.reduce((total, tap) => total + tap, 0);
        return {
          taps: taps.map((tap) => tap / sum),
          weight: a * Math.sqrt(Math.PI / b) * sum * sum,
        };
      });
    const total = parts.reduce((sum, part) => sum + part.weight, 0);
    const result = new Float32Array(plane.length);
    for (const { taps, weight } of parts) {
      const filtered = separable(plane, width, height, taps, taps);
      filtered.forEach((value, i) => (result[i] += (weight / total) * value));
    }
    return result;
  });
}

function featureDifference(grey, other, width, height) {
  const sigma = 0.5 * WIDTH * PPD;
  const radius = Math.ceil(3 * sigma);
  const gauss = kernel(radius, (x) => Math.exp((-x * x) / (2 * sigma * sigma)));
  const sum = gauss.reduce((total, tap) => total + tap, 0);
  const smooth = gauss.map((tap) => tap / sum);
  const at = (i) => i - radius;
  const edge = balance(gauss.map((tap, i) => -at(i) * tap));
  const point = balance(gauss.map((tap, i) => ((at(i) * at(i)) / (sigma * sigma) - 1) * tap));
  const sizes = [edge, point].map((taps) =>
    [grey, other].map((plane) => {
      const across = separable(plane, width, height, taps, smooth);
      const down = separable(plane, width, height, smooth, taps);
      return across.map((value, i) => Math.hypot(value, down[i]));
    }),
  );
  return grey.map((_, i) => {
    const differences = sizes.map(([a, b]) => Math.abs(a[i] - b[i]));
    return (Math.max(...differences) / Math.SQRT2) ** QF;
  });
}

/** Positive taps sum to 1, negative ones to -1. */
function balance(taps) {
  const sum = (sign) => taps.reduce((total, tap) => total + Math.max(sign * tap, 0), 0);
  const [positive, negative] = [sum(1), sum(-1)];
  return taps.map((tap) => tap / (tap > 0 ? positive : negative));
}

function kernel(radius, f) {
  return Float64Array.from({ length: 2 * radius + 1 }, (_, i) => f(i - radius));
}

/** Correlation with `across` along rows and `down` along columns; edges are repeated. */
function separable(plane, width, height, across, down) {
  const radius = (across.length - 1) / 2;
  const rows = new Float32Array(plane.length);
  const result = new Float32Array(plane.length);
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0; x < width; x++, i++) {
      let sum = 0;
      for (let k = -radius; k <= radius; k++) {
        sum += across[k + radius] * plane[i - x + Math.min(Math.max(x + k, 0), width - 1)];
      }
      rows[i] = sum;
    }
  }
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0; x < width; x++, i++) {
      let sum = 0;
      for (let k = -radius; k <= radius; k++) {
        sum += down[k + radius] * rows[Math.min(Math.max(y + k, 0), height - 1) * width + x];
      }
      result[i] = sum;
    }
  }
  return result;
}

function invert([[a, b, c], [d, e, f], [g, i, j]]) {
  const det = a * (e * j - f * i) - b * (d * j - f * g) + c * (d * i - e * g);
  return [
    [e * j - f * i, c * i - b * j, b * f - c * e],
    [f * g - d * j, a * j - c * g, c * d - a * f],
    [d * i - e * g, b * g - a * i, a * e - b * d],
  ].map((row) => row.map((value) => value / det));
}
