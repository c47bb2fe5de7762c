"""Images as small blobs of text that a page decodes: rounded, predicted, deflated.

Radiance and depth are rounded on a logarithmic scale, so that their relative error is bounded,
other planes on a linear one. A pixel is predicted from its left, upper and upper left neighbours by
the median edge detector of Weinberger, Seroussi and Sapiro 2000 (The LOCO-I Lossless Image
Compression Algorithm, section III.A). Residuals of each plane are grouped by how much these
neighbours differ, and each group has a Huffman code. `assets/tiles.js` is the decoder.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reports.analysis.images import Floats

DARK = 2.0**-7  # radiance below which the steps of LogScale are nearly equal
LARGEST = 2.0**16  # larger values are stored as this
GROUPS = (3, 7, 15)  # differences of neighbours at which the next group begins
ESCAPE = 255  # in place of a residual that does not fit a byte; it follows at the end, in four
Codes = NDArray[np.int32]


@dataclass(frozen=True)
class LogScale:
    """Codes of sign(v) log2(1 + |v| / DARK), `steps` of them an octave; inf and NaN have their own.

    The error of a value v is at most (|v| + DARK) (2^(1 / (2 steps)) - 1).
    """

    steps: int
    kind: str = "log"
    dark: float = DARK

    @property
    def relative_error(self) -> float:
        """Bound of the error, as a share of a bright value."""
        return float(2 ** (0.5 / self.steps) - 1)

    @property
    def top(self) -> int:
        """The largest code of a finite value; the next is infinity, and then NaN."""
        return round(self.steps * float(np.log2(1 + LARGEST / DARK)))

    def codes(self, values: Floats) -> Codes:
        """The nearest code of each value."""
        size = np.abs(values.astype(np.float64))
        logs = np.log2(1 + np.minimum(np.nan_to_num(size), LARGEST) / DARK)
        codes = np.minimum(np.rint(self.steps * logs), self.top)
        codes = np.where(
            np.isinf(size), self.top + 1, np.where(np.isnan(size), self.top + 2, codes)
        )
        signed: Codes = np.where(values < 0, -codes, codes).astype(np.int32)
        return signed


@dataclass(frozen=True)
class LinearScale:
    """Codes of v / `step`, up to a size of 32000.

    >>> LinearScale(0.25).codes(np.array([1.0, -0.5])).tolist()
    [4, -2]
    """

    step: float
    kind: str = "linear"

    def codes(self, values: Floats) -> Codes:
        """The nearest code of each value."""
        codes: Codes = (
            np.rint(np.nan_to_num(values) / self.step).clip(-32000, 32000).astype(np.int32)
        )
        return codes


def encode(planes: Floats, scale: LogScale | LinearScale) -> dict[str, Any]:
    """An image [c h w] as a JSON object: shape, scale, sizes of the groups [c 4], base64 blob."""
    codes = scale.codes(planes)
    if len(codes) == 3:  # channels are alike
        codes = np.stack([codes[1], codes[0] - codes[1], codes[2] - codes[1]])
    predicted, group = _predict(codes)
    residual = codes - predicted
    folded = np.where(residual < 0, -2 * residual - 1, 2 * residual)
    parts = [
        plane[own == index]
        for plane, own in zip(folded, group, strict=True)
        for index in range(len(GROUPS) + 1)
    ]
    strategy = zlib.Z_HUFFMAN_ONLY if isinstance(scale, LogScale) else zlib.Z_RLE
    blob = base64.b64encode(_deflate(parts, folded[folded >= ESCAPE], strategy)).decode()
    groups = [len(part) for part in parts]
    return {"shape": list(planes.shape), "scale": asdict(scale), "groups": groups, "blob": blob}


def _predict(codes: Codes) -> tuple[Codes, NDArray[np.intp]]:
    """The median of left, up and left + up - upper left, 0 outside of the image; and the group."""
    padded = np.pad(codes, ((0, 0), (1, 0), (1, 0)))
    left, up, corner = padded[:, 1:, :-1], padded[:, :-1, 1:], padded[:, :-1, :-1]
    low, high = np.minimum(left, up), np.maximum(left, up)
    differences = np.abs(left - corner) + np.abs(up - corner)
    group = np.searchsorted(GROUPS, differences, side="right")
    return np.clip(left + up - corner, low, high), group


def _deflate(parts: list[Codes], escaped: Codes, strategy: int) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS, 9, strategy)
    packed = []
    for part in parts:
        packed.append(packer.compress(np.minimum(part, ESCAPE).astype(np.uint8).tobytes()))
        packed.append(packer.flush(zlib.Z_BLOCK))
    # in the order of planes, rows and columns, as the decoder meets them
    return b"".join([*packed, packer.compress(escaped.astype("<u4").tobytes()), packer.flush()])
