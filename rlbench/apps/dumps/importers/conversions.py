"""Conversions from a renderer's conventions to those of a clip: functions of arrays [h w c]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.ndimage import map_coordinates

from rlbench.apps.dumps.importers.layout import Albedo, Depth, Motion, Normal
from rlbench.clips.image_files import Pixels
from rlbench.errors import SourceError
from rlbench.ops.color import decode_srgb

OUTSIDE = -2.0  # image sizes, along both axes, that motion without a history points away
MIN_NORMAL_LENGTH = 0.1  # shorter normals are background
REVERSALS = 12  # steps of the search for the pixel that moved to a pixel
MAX_REVERSAL_ERROR = 0.5  # pixels: beyond it no pixel moved there, so it was not visible before
AXES = {f"{sign}{axis}": (i, s) for i, axis in enumerate("xyz") for sign, s in (("", 1), ("-", -1))}


def decode_curve(image: Pixels, encoding: str) -> Pixels:
    """Linear values of an image that is linear or sRGB-encoded, float32."""
    values = np.asarray(image, np.float32)
    if encoding == "linear":
        return values
    return np.asarray(decode_srgb(torch.from_numpy(values)).numpy())


def convert_albedo(stored: Pixels, albedo: Albedo) -> Pixels:
    """Linear albedo in [0, 1], clipped. A pixel with a value that is not finite becomes 0."""
    linear = decode_curve(stored, albedo.encoding) * albedo.scale
    is_finite = np.isfinite(linear).all(-1, keepdims=True)
    return np.asarray(np.where(is_finite, np.clip(linear, 0, 1), 0))


def convert_normal(stored: Pixels, normal: Normal, rotation: Float[Array, "3 3"] | None) -> Pixels:
    """Unit normals, 0 for background; rotated to world space where a rotation is given.

    Values that are all 0, one of them not finite, or shorter than 0.1 are background.
    """
    values = np.asarray(stored, np.float64)  # squares of any float32 are finite
    values = np.where(np.isfinite(values).all(-1, keepdims=True), values, 0)
    empty = (values == 0).all(-1, keepdims=True)
    decoded = 2 * values - 1 if normal.encoded else values
    order = [parse_axis(word, "[normal] axes") for word in normal.axes]
    decoded = np.stack([sign * decoded[..., index] for index, sign in order], -1)
    length = np.linalg.norm(decoded, axis=-1, keepdims=True)
    empty = empty | (length < MIN_NORMAL_LENGTH)
    unit = np.where(empty, 0, decoded / np.maximum(length, MIN_NORMAL_LENGTH))
    return np.asarray(unit if rotation is None else unit @ rotation.T, np.float32)


def convert_depth(stored: Pixels, depth: Depth) -> Pixels:
    """Distance along the view axis, +inf for background, float32. Raises SourceError."""
    values = np.asarray(stored, np.float64)
    empty = ~np.isfinite(values)
    if depth.far is not None:
        empty |= values >= depth.far if depth.far > 0 else values <= depth.far
    if depth.background is not None:
        empty |= values == depth.background
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = _view_distance(values, depth)
    return np.where(empty | ~np.isfinite(distance), np.inf, distance).astype(np.float32)


def convert_motion(
    stored: Pixels, motion: Motion, previous: Float[Array, "h w 2"] | None = None
) -> Float[Array, "h w 2"]:
    """Motion in pixels to the previous frame, x right, y down, float32.

    `previous` is the stored motion of the previous frame, which vectors to the next frame need.
    Vectors that are not finite, and those to the next frame where no pixel moved to, point outside
    the image.
    """
    if motion.points.endswith("previous"):
        vectors = _to_pixels(stored, motion)
        vectors = -vectors if motion.points.startswith("from") else vectors
    else:
        assert previous is not None
        onward = _to_pixels(previous, motion)
        vectors = _reverse(-onward if motion.points.startswith("from") else onward)
    h, w = vectors.shape[:2]
    invalid = ~np.isfinite(vectors).all(-1, keepdims=True)
    return np.where(invalid, np.multiply(OUTSIDE, (w, h)), vectors).astype(np.float32)


def separate_samples(means: Sequence[Pixels]) -> list[Pixels]:
    """The samples whose means over the first 1, 2, 3, ... are given, float32.

    Sample k is k mean_k - (k - 1) mean_(k-1), so rounding of the means grows by 2 k; values below 0
    that it causes become 0.

    >>> means = [np.full((1, 1, 3), value) for value in (2.0, 3.0)]
    >>> [float(sample[0, 0, 0]) for sample in separate_samples(means)]
    [2.0, 4.0]
    """
    totals = [k * np.asarray(mean, np.float64) for k, mean in enumerate(means, 1)]
    samples = [totals[0], *(b - a for a, b in zip(totals, totals[1:], strict=False))]
    return [np.maximum(sample, 0).astype(np.float32) for sample in samples]


def _to_pixels(stored: Pixels, motion: Motion) -> Float[Array, "h w 2"]:
    """Vectors in pixels, x right and y down; where they point is that of the layout."""
    h, w = stored.shape[:2]
    units = {"pixels": (1, 1), "ndc": (w / 2, h / 2), "shares": (w, h)}[motion.unit]
    upright = (1, -1 if motion.y == "up" else 1)
    factor = np.multiply(np.multiply(units, upright), motion.scale)
    return np.asarray((np.asarray(stored, np.float64) - motion.offset) * factor)


def _reverse(onward: Float[Array, "h w 2"]) -> Float[Array, "h w 2"]:
    """Motion back from the frame into which `onward` points; NaN where no pixel moved.

    The origin q of a pixel p solves q + onward(q) = p, by fixed-point iteration.
    """
    h, w = onward.shape[:2]
    target = np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).astype(np.float64)
    field = np.where(np.isfinite(onward), onward, OUTSIDE * max(h, w))
    origin = target - field
    for _ in range(REVERSALS):
        origin = target - _sample(field, origin)
    error = np.abs(origin + _sample(field, origin) - target).max(-1, keepdims=True)
    return np.where(error > MAX_REVERSAL_ERROR, np.nan, origin - target)


def _sample(image: Pixels, position: Float[Array, "h w 2"]) -> Pixels:
    """The image at positions in pixels, by linear interpolation."""
    rows_columns = np.moveaxis(position[..., ::-1], -1, 0)
    planes = [
        map_coordinates(plane, rows_columns, order=1, mode="nearest")
        for plane in np.moveaxis(image, -1, 0)
    ]
    return np.stack(planes, -1)


def _view_distance(values: Pixels, depth: Depth) -> Pixels:
    if depth.kind == "view":
        return values * depth.scale
    if depth.kind == "inverse":
        return depth.scale / values
    if depth.kind == "distance":
        if depth.fov is None:
            raise SourceError(
                "[depth] kind 'distance' needs fov, the horizontal field of view in degrees"
            )
        h, w = values.shape[:2]
        return np.asarray(values * depth.scale / _ray_length(h, w, depth.fov))
    if depth.near is None:
        raise SourceError(f"[depth] kind '{depth.kind}' needs near, the distance of the near plane")
    window = 1 - values if depth.kind.startswith("reversed") else values
    distance = depth.near / (1 - window * (1 - depth.near / depth.far_plane))
    return np.where(window < 1, depth.scale * distance, np.inf)  # a cleared buffer is background


def _ray_length(h: int, w: int, fov: float) -> Float[Array, "h w 1"]:
    """Length of the ray through each pixel that ends one unit along the view axis."""
    focal = w / 2 / np.tan(np.radians(fov) / 2)
    x = (np.arange(w) + 0.5 - w / 2) / focal
    y = (np.arange(h)[:, None] + 0.5 - h / 2) / focal
    return np.asarray(np.sqrt(1 + x**2 + y**2)[..., None])


def parse_axis(word: str, key: str) -> tuple[int, int]:
    """Index and sign of an axis such as "-y". Raises SourceError, naming the key of the layout."""
    if word not in AXES:
        raise SourceError(f"{key} has '{word}', expected {', '.join(AXES)}")
    return AXES[word]
