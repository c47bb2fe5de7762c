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


def mirror_inside(index: int, size: int) -> int:
    """The index of a pixel beyond the border, the border pixel not repeated."""
    return 2 * size - 2 - index if index >= size else abs(index)


def neighbour_variance(image):
    """The squared distance from the mean of the up to eight neighbours."""
    h, w, _ = image.shape
    variance = np.zeros((h, w))
    for y in range(h):
        for x in range(w):
            near = [
                image[v, u]
                for v in range(max(y - 1, 0), min(y + 2, h))
                for u in range(max(x - 1, 0), min(x + 2, w))
                if (v, u) != (y, x)
            ]
            variance[y, x] = ((image[y, x] - np.mean(near, 0)) ** 2).sum()
    return variance


def cross_regression(explaining, response, albedo, normal, side=17, step=4):
    """Weighted ridge regressions by `numpy.linalg.lstsq`, and the mean of their predictions."""
    h, w, _ = response.shape
    variance = neighbour_variance(explaining)
    reach = side // 2

    def explain(pixel, centre, channel):
        deviations = math.sqrt(variance[pixel]) + math.sqrt(variance[centre]) + 1e-2
        colour = (explaining[pixel] - explaining[centre])[channel] / deviations
        return [
            1,
            colour,
            (albedo[pixel] - albedo[centre])[channel],
            *(normal[pixel] - normal[centre]),
        ]

    def weigh(pixel, centre):
        distance = ((explaining[pixel] - explaining[centre]) ** 2).sum()
        return math.exp(-distance / (variance[pixel] + variance[centre] + 1e-4)) + 1e-7

    total, weights = np.zeros((h, w, 3)), np.zeros((h, w, 1))
    for cy in range(0, h, step):
        for cx in range(0, w, step):
            places = [
                (cy + i, cx + j) for i in range(-reach, reach + 1) for j in range(-reach, reach + 1)
            ]
            pixels = [(mirror_inside(y, h), mirror_inside(x, w)) for y, x in places]
            root = np.sqrt([weigh(p, (cy, cx)) for p in pixels])[:, None]
            solved = []
            for channel in range(3):
                rows = np.array([explain(p, (cy, cx), channel) for p in pixels]) * root
                matrix = np.concatenate([rows, math.sqrt(1e-3) * np.eye(6)])
                values = np.array([response[p][channel] for p in pixels]) * root[:, 0]
                target = np.concatenate([values, np.zeros(6)])
                solved.append(np.linalg.lstsq(matrix, target, rcond=None)[0])
            for pixel in {p for p in places if p in set(pixels) and p[0] >= 0 and p[1] >= 0}:
                weight = weigh(pixel, (cy, cx))
                predicted = [explain(pixel, (cy, cx), c) @ solved[c] for c in range(3)]
                total[pixel] += weight * np.array(predicted)
                weights[pixel] += weight
    return np.maximum(total / weights, 0)


def cross_bilateral(pilots, surface, bands, side=11):
    """Sums of colours and of weights of both pilots, [h w 2 4]."""
    h, w, _ = pilots.shape
    reach = side // 2
    sums = np.zeros((h, w, 2, 4))
    for y in range(h):
        for x in range(w):
            for i in range(-reach, reach + 1):
                for j in range(-reach, reach + 1):
                    q = mirror_inside(y + i, h), mirror_inside(x + j, w)
                    apart = (surface[y, x] - surface[q]) ** 2
                    shared = bands[y, x, 2] * apart[:3].sum() + bands[y, x, 3] * apart[3:].sum()
                    shared += bands[y, x, 4] * (i * i + j * j) / reach**2
                    for k in range(2):
                        colour = pilots[q][3 * k : 3 * k + 3]
                        distance = ((pilots[y, x, 3 * k : 3 * k + 3] - colour) ** 2).sum()
                        weight = math.exp(-bands[y, x, k] * distance - shared)
                        sums[y, x, k] += weight * np.array([*colour, 1])
    return sums
