// Decodes what rlbench/apps/view/viewer/tiles.py encodes.

const GROUPS = [3, 7, 15];
const ESCAPE = 255;

/** An image of a tile: width, height, channels, and `planes`, a Float32Array for each channel. */
export async function decode(tile) {
  const [channels, height, width] = tile.shape;
  const bytes = await inflate(tile.blob);
  const area = width * height;
  const starts = tile.groups.map((_, i) =>
    tile.groups.slice(0, i).reduce((sum, size) => sum + size, 0),
  );
  const escaped = new DataView(bytes.buffer, channels * area);
  let next = 0;
  const codes = [];
  for (let c = 0; c < channels; c++) {
    const plane = new Int32Array(area);
    for (let y = 0, i = 0; y < height; y++) {
      for (let x = 0; x < width; x++, i++) {
        const left = x ? plane[i - 1] : 0;
        const up = y ? plane[i - width] : 0;
        const corner = x && y ? plane[i - width - 1] : 0;
        const differences = Math.abs(left - corner) + Math.abs(up - corner);
        const group =
          differences < GROUPS[0]
            ? 0
            : differences < GROUPS[1]
              ? 1
              : differences < GROUPS[2]
                ? 2
                : 3;
        let folded = bytes[starts[4 * c + group]++];
        if (folded === ESCAPE) folded = escaped.getUint32(4 * next++, true);
        const residual = folded & 1 ? -((folded + 1) >> 1) : folded >> 1;
        const low = Math.min(left, up);
        const high = Math.max(left, up);
        plane[i] = residual + Math.min(Math.max(left + up - corner, low), high);
      }
    }
    codes.push(plane);
  }
  const toValues = tile.scale.kind === "log" ? logValues(tile.scale) : linearValues(tile.scale);
  return { width, height, channels, planes: restore(codes).map(toValues) };
}

async function inflate(blob) {
  const packed = Uint8Array.from(atob(blob), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Green, red - green and blue - green to red, green and blue; other images stay. */
function restore(codes) {
  if (codes.length !== 3) return codes;
  const [green, red, blue] = codes;
  return [red.map((code, i) => code + green[i]), green, blue.map((code, i) => code + green[i])];
}

function linearValues(scale) {
  return (codes) => Float32Array.from(codes, (code) => code * scale.step);
}

function logValues(scale) {
  const top = Math.round(scale.steps * Math.log2(1 + 2 ** 16 / scale.dark));
  const table = Float32Array.from(
    { length: top + 3 },
    (_, code) => scale.dark * (2 ** (code / scale.steps) - 1),
  );
  table[top + 1] = Infinity;
  table[top + 2] = NaN;
  return (codes) => Float32Array.from(codes, (code) => (code < 0 ? -table[-code] : table[code]));
}
