"""BMFR and online cross-regression as plain loops in double precision, written from the papers.

Images are [h w c] arrays. Nothing is shared with the methods but their constants.
"""

from __future__ import annotations

import math

import numpy as np


def mirror_once(index: int, size: int) -> int:
    """The index of a pixel beyond the border, the border pixel repeated."""
    while not 0 <= index < size:
        index = -1 - index if index < 0 else 2 * size - 1 - index
    return index


def fit_by_blocks(light, features, surface, offset, noise, ridge, side=32):
    """The clamped prediction at each pixel; `noise` [features side^2] is added before the fit."""
    h, w, _ = light.shape
    count = features.shape[2]
    fitted = np.zeros((h, w, 3))
    for top in range(-side // 2 + offset[1], h, side):
        for left in range(-side // 2 + offset[0], w, side):
            places = [(top + i, left + j) for i in range(side) for j in range(side)]
            pixels = [(mirror_once(y, h), mirror_once(x, w)) for y, x in places]
            known = [p for p in pixels if surface[p]]
            if not known:
                continue
            block = np.array([features[p] for p in known])
            least, spread = block.min(0), np.ptp(block, 0)
            least[:4], spread[:4] = 0, 0

            def scale(pixel, least=least, spread=spread):
                return (features[pixel] - least) / np.maximum(spread, 1)

            rows = [
                scale(p) + noise[:, i] if surface[p] else np.zeros(count)
                for i, p in enumerate(pixels)
            ]
            values = [light[p] if surface[p] else np.zeros(3) for p in pixels]
            matrix = np.concatenate([rows, ridge * np.eye(count)])
            target = np.concatenate([values, np.zeros((count, 3))])
            weights = np.linalg.lstsq(matrix, target, rcond=None)[0]
            for (y, x), p in zip(places, pixels, strict=True):
                if (y, x) == p and surface[p]:
                    fitted[p] = scale(p) @ weights
    return np.maximum(fitted, 0)


def surface_taps(motion, now, before, min_cosine):
    """For each pixel the list of (y, x, weight) of the last frame, weights normalised."""
    (depth, normal), (old_depth, old_normal) = now, before
    h, w = depth.shape
    taps = {}
    for y in range(h):
        for x in range(w):
            px, py = x + motion[y, x, 0], y + motion[y, x, 1]
            left, top = math.floor(px), math.floor(py)
            found = []
            for v, u in [(top + i, left + j) for i in (0, 1) for j in (0, 1)]:
                weight = (1 - abs(px - u)) * (1 - abs(py - v))
                if (
                    0 <= u < w
                    and 0 <= v < h
                    and abs(old_depth[v, u] - depth[y, x]) <= 0.1 * depth[y, x]
                    and old_normal[v, u] @ normal[y, x] >= min_cosine
                ):
                    found.append((v, u, weight))
            total = sum(weight for *_, weight in found)
            taps[y, x] = [(v, u, g / total) for v, u, g in found] if total >= 0.01 else []
    return taps


def gather(history, taps):
    """The weighted mean of the taps; 0 without any."""
    moved = np.zeros_like(history)
    for (y, x), found in taps.items():
        for v, u, weight in found:
            moved[y, x] += weight * history[v, u]
    return moved


def antialias(image, previous, alpha):
    """Clamped to the mean bounds of box and cross in YCoCg, as a matrix product."""
    matrix = np.array([[0.25, 0.5, 0.25], [0.5, 0, -0.5], [-0.25, 0.5, -0.25]])
    colour, old = image @ matrix.T, previous @ matrix.T
    h, w, _ = image.shape
    mixed = np.zeros_like(image)
    for y in range(h):
        for x in range(w):
            near = [
                (colour[v, u], v == y or u == x)
                for v in range(max(y - 1, 0), min(y + 2, h))
                for u in range(max(x - 1, 0), min(x + 2, w))
            ]
            box = np.array([c for c, _ in near])
            cross = np.array([c for c, is_cross in near if is_cross])
            low, high = (box.min(0) + cross.min(0)) / 2, (box.max(0) + cross.max(0)) / 2
            clamped = np.clip(old[y, x], low, high)
            mixed[y, x] = np.linalg.solve(matrix, alpha * colour[y, x] + (1 - alpha) * clamped)
    return np.maximum(mixed, 0)
