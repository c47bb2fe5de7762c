"""Kinds of pixels: by motion, disocclusion, edges and luminance; with numpy, from a clip's buffers.

Conventions of clips: motion leads from a pixel to its position one frame before, in pixels, x right
and y down; depth is the distance along the view axis, infinite for the background.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from reports.analysis.image_errors import Floats, luminance

__all__ = ["KINDS", "classify"]

STILL, FAST = 0.25, 2.0  # pixels a frame: below the first still, above the second fast
DEPTH_CHANGE = 0.1  # relative, from which two depths belong to different surfaces
NORMAL_CHANGE = 0.8  # cosine of two neighbouring normals, below which there is an edge
DARK, BRIGHT = 0.05, 0.5  # linear luminance; 1.0 is display white
KINDS = {  # title of a kind: its classes, in the order of `classify`
    "motion": ("still", "slow", "fast"),
    "visibility": ("seen before", "disoccluded"),
    "geometry": ("smooth", "edge"),
    "luminance": ("dark", "middle", "bright"),
}

Classes = NDArray[np.intp]


def classify(reference: Floats, buffers: Mapping[str, Floats]) -> dict[str, Classes]:
    """The class [t h w] of each pixel for each kind that the buffers allow.

    `reference` is linear, [t 3 h w]; `buffers` may have motion, depth and normal, [t c h w]. Frame
    0 has no frame before it: its pixels are disoccluded. Without motion the camera and all objects
    stand still.
    """
    classes = {"luminance": _bands(luminance(reference), DARK, BRIGHT)}
    if "depth" in buffers or "normal" in buffers:
        classes["geometry"] = _edges(buffers).astype(np.intp)
    if "motion" in buffers:
        motion = buffers["motion"].astype(np.float32)
        classes["motion"] = _bands(np.hypot(motion[:, 0], motion[:, 1]), STILL, FAST)
        if "depth" in buffers:
            depth = buffers["depth"][:, 0].astype(np.float32)
            hidden = [_is_hidden(depth[t - 1], depth[t], motion[t]) for t in range(1, len(depth))]
            first = np.ones_like(depth[0], bool)
            classes["visibility"] = np.stack([first, *hidden]).astype(np.intp)
    return {kind: classes[kind] for kind in KINDS if kind in classes}


def _bands(values: Floats, low: float, high: float) -> Classes:
    """0 below `low`, 2 from `high` on, else 1; a motion that is not finite is fast."""
    return np.digitize(np.nan_to_num(values, nan=np.inf), [low, high])


def _is_hidden(before: Floats, now: Floats, motion: Floats) -> NDArray[np.bool_]:
    """Whether a pixel [h w] was outside of the frame before, or behind another surface."""
    height, width = now.shape
    y, x = np.indices((height, width), dtype=np.float32)
    at_x, at_y = np.rint(x + motion[0]), np.rint(y + motion[1])
    is_outside = ~((at_x >= 0) & (at_x < width) & (at_y >= 0) & (at_y < height))
    rows = np.where(is_outside, 0, at_y).astype(int)
    columns = np.where(is_outside, 0, at_x).astype(int)
    hidden: NDArray[np.bool_] = is_outside | _is_apart(before[rows, columns], now)
    return hidden


def _is_apart(depth: Floats, other: Floats) -> NDArray[np.bool_]:
    """Whether two depths differ by more than DEPTH_CHANGE; background equals background."""
    is_far, is_other_far = np.isinf(depth), np.isinf(other)
    near, far = np.where(is_far, 0, depth), np.where(is_other_far, 0, other)
    is_changed = np.abs(near - far) > DEPTH_CHANGE * np.maximum(near, far)
    apart: NDArray[np.bool_] = (is_far != is_other_far) | (~is_far & ~is_other_far & is_changed)
    return apart


def _edges(buffers: Mapping[str, Floats]) -> NDArray[np.bool_]:
    """Pixels [t h w] next to another depth or normal, and their neighbours."""
    shape = next(buffers[name].shape for name in ("depth", "normal") if name in buffers)
    found = np.zeros((shape[0], *shape[2:]), bool)
    for axis in (1, 2):
        ahead = (slice(None),) * axis + (slice(1, None),)
        behind = (slice(None),) * axis + (slice(None, -1),)
        if "depth" in buffers:
            depth = buffers["depth"][:, 0].astype(np.float32)
            found[ahead] |= _is_apart(depth[ahead], depth[behind])
        if "normal" in buffers:
            normal = np.moveaxis(buffers["normal"].astype(np.float32), 1, -1)
            found[ahead] |= (normal[ahead] * normal[behind]).sum(-1) < NORMAL_CHANGE
    cross = ndimage.generate_binary_structure(2, 1)[None]
    widened: NDArray[np.bool_] = ndimage.binary_dilation(found, cross)
    return widened
