"""What R, G and B of an OpenEXR file mean: its chromaticities, and the way to Rec. 709.

Radiance is linear with Rec. 709 primaries here, as in a file that says nothing. A file says others
by its attribute `chromaticities`, or by `colorInteropID`, the name of a colour space (Academy
Software Foundation, Color Interop Forum).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import OpenEXR
from jaxtyping import Float
from numpy import ndarray as Array
from numpy.typing import NDArray

Chromaticities = tuple[float, ...]  # CIE 1931 x, y of red, green, blue and white

REC709: Chromaticities = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
TOLERANCE = 1e-3  # of x and y, within which files mean the same primaries; as the library has it
MIN_VOLUME = 1e-3  # of the primaries as columns; Rec. 709 has 0.2, and on one line they span none
VISIBLE = 1e-4  # of a pixel's largest channel: less below 0 is rounding
NO_SPACE = ("", "data", "unknown", "lin_rec709_scene")  # names that ask for no conversion
BRADFORD = np.array(  # Lam 1985, as in ICC.1:2010, annex E
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def find_chromaticities(stored: Chromaticities | None, space: str) -> Chromaticities | None:
    """The primaries that a file means, None for Rec. 709.

    `stored` is its attribute chromaticities, which decides, `space` its colorInteropID. Raises
    ValueError for a space that is not linear or not known, and for primaries that span no colours.
    """
    found = stored or (None if space in NO_SPACE else OpenEXR.colorInteropIDToChromaticities(space))
    if found is None and space not in NO_SPACE:
        raise ValueError(
            f"its colorInteropID is '{space}', which is not a linear space with known primaries; "
            "convert it to linear Rec. 709"
        )
    if found is None or np.allclose(found, REC709, rtol=0, atol=TOLERANCE):
        return None
    if not _span_colours(np.array(found)):
        raise ValueError(
            f"its chromaticities span no colours: {format_chromaticities(found)}; correct them, or "
            "convert the image to linear Rec. 709"
        )
    return tuple(found)


def format_chromaticities(values: Chromaticities) -> str:
    """Chromaticities for a message.

    >>> format_chromaticities(REC709)
    'red 0.64 0.33, green 0.3 0.6, blue 0.15 0.06, white 0.3127 0.329'
    """
    names = ("red", "green", "blue", "white")
    pairs = zip(values[::2], values[1::2], strict=True)
    return ", ".join(f"{n} {x:.4g} {y:.4g}" for n, (x, y) in zip(names, pairs, strict=True))


def matrix_to_rec709(primaries: Chromaticities) -> Float[Array, "3 3"]:
    """The matrix from linear RGB of these primaries to that of Rec. 709.

    White stays white: where it is not D65, it is adapted by the method of Bradford.

    >>> display_p3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)
    >>> matrix_to_rec709(display_p3).round(4)[0].tolist()
    [1.2249, -0.2249, -0.0]
    """
    white, target = _white(primaries), _white(REC709)
    gain = (BRADFORD @ target) / (BRADFORD @ white)
    adaptation = np.linalg.solve(BRADFORD, gain[:, None] * BRADFORD)
    return np.asarray(np.linalg.solve(_to_xyz(REC709), adaptation @ _to_xyz(primaries)))


def convert_to_rec709(
    pixels: Float[Array, "h w 3"], primaries: Chromaticities
) -> tuple[Float[Array, "h w 3"], NDArray[np.bool_]]:
    """Linear RGB of these primaries as Rec. 709, float32, and where [h w] it cannot show them.

    There a channel would be negative, and becomes 0. Pixels that had a negative one before stay so.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        converted = np.asarray(pixels, np.float64) @ matrix_to_rec709(primaries).T
        is_valid = pixels.min(-1) >= 0
        outside = is_valid & (converted.min(-1) < -VISIBLE * converted.max(-1))
        clipped = np.where(is_valid[..., None], np.maximum(converted, 0), converted)
        return clipped.astype(np.float32), np.asarray(outside)


def _span_colours(primaries: NDArray[Any]) -> bool:
    """Whether the primaries are not on one line, and white is a light."""
    if not (np.isfinite(primaries).all() and primaries[7] > MIN_VOLUME):
        return False
    is_light = (BRADFORD @ _white(tuple(primaries)) > MIN_VOLUME).all()
    return bool(is_light and abs(np.linalg.det(_columns(primaries))) > MIN_VOLUME)


def _to_xyz(primaries: Chromaticities) -> Float[Array, "3 3"]:
    """The matrix from RGB to CIE XYZ (Lindbloom, RGB/XYZ Matrices); also for a primary of y = 0."""
    columns = _columns(np.array(primaries))
    return np.asarray(columns * np.linalg.solve(columns, _white(primaries)))


def _columns(primaries: NDArray[Any]) -> Float[Array, "3 3"]:
    """Red, green and blue as columns x, y, z whose sum is 1."""
    x, y = primaries[0:6:2], primaries[1:6:2]
    return np.stack([x, y, 1 - x - y])


def _white(primaries: Chromaticities) -> Float[Array, " 3"]:
    """CIE XYZ of white with Y = 1."""
    x, y = primaries[6:]
    return np.array([x / y, 1, (1 - x - y) / y])
