"""SVGF and EAW pixel by pixel, in double precision: slow, obvious, written from the papers' text.

Images are [h w c] arrays. Nothing here is shared with the methods but their numbers.
"""

from __future__ import annotations

import math

import numpy as np

B3 = np.array([1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16])
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def area_albedo(albedo):
    """What light is divided by: the albedo of the pixels around that reflect, by distance."""
    h, w, _ = albedo.shape
    divisor = albedo.copy()
    for y, x in np.argwhere(albedo.max(-1) > 0):
        total, weights = np.zeros(3), 0.0
        for v in range(max(y - 1, 0), min(y + 2, h)):
            for u in range(max(x - 1, 0), min(x + 2, w)):
                if albedo[v, u].max() > 0:
                    weight = 0.5 ** (abs(v - y) + abs(u - x))
                    total, weights = total + weight * albedo[v, u], weights + weight
        divisor[y, x] = total / weights
    return np.clip(divisor, 1e-3, 1)


def svgf(noisy, gbuffer, memory, alpha=0.2, alpha_moments=0.2, passes=5, feedback=0, sigma=4.0):
    """Image and memory of one frame; `memory` is None before the first."""
    albedo, normal, depth, motion = gbuffer
    h, w = depth.shape
    solid = np.isfinite(depth) & (albedo.max(-1) > 0)
    divisor = area_albedo(albedo)
    now = noisy / divisor

    # over time
    colour = np.zeros((h, w, 3))
    moments = np.zeros((h, w, 2))
    length = np.zeros((h, w))
    variance = np.zeros((h, w))
    for y, x in np.argwhere(solid):
        old = _recall(memory, y, x, depth[y, x], normal[y, x], motion)
        lum = now[y, x] @ LUMINANCE
        fresh = np.array([*now[y, x], lum, lum**2])
        length[y, x] = 1 if old is None else min(old[5] + 1, 32)
        if old is not None:
            a, am = max(alpha, 1 / length[y, x]), max(alpha_moments, 1 / length[y, x])
            share = np.array([a, a, a, am, am])
            fresh = share * fresh + (1 - share) * old[:5]
        colour[y, x], moments[y, x] = fresh[:3], fresh[3:]
        variance[y, x] = max(0, fresh[4] - fresh[3] ** 2)

    # over the neighbourhood of what is young
    slope = _slope(depth, solid)
    start = colour.copy()
    for y, x in np.argwhere(solid & (length < 4)):
        weights, ys, xs = _window(y, x, 3, 1, colour, sigma, depth, normal, slope, solid)
        mean = weights @ np.concatenate([colour, moments], -1)[ys, xs] / weights.sum()
        start[y, x] = mean[:3]
        variance[y, x] = max(0, mean[4] - mean[3] ** 2) * 4 / length[y, x]

    filtered, remembered = start, None
    for i in range(passes):
        filtered, variance = _wavelet(i, filtered, variance, sigma, depth, normal, slope, solid)
        remembered = filtered if i == feedback else remembered
    image = np.where(solid[..., None], filtered * divisor, noisy)
    return image, (remembered, moments, length, depth, normal)


def eaw(noisy, gbuffer, phi_light, phi_normal, phi_depth, passes=5):
    """One frame; the widths are those of the first pass."""
    albedo, normal, depth, _ = gbuffer
    h, w = depth.shape
    solid = np.isfinite(depth) & (albedo.max(-1) > 0)
    divisor = area_albedo(albedo)
    image = noisy / divisor
    for i in range(passes):
        before, image = image, image.copy()
        for y, x in np.argwhere(solid):
            total, weights = 0, 0
            for ky in range(-2, 3):
                for kx in range(-2, 3):
                    qy, qx = y + ky * 2**i, x + kx * 2**i
                    if not (0 <= qy < h and 0 <= qx < w and solid[qy, qx]):
                        continue
                    light = np.log1p(before[y, x]) - np.log1p(before[qy, qx])
                    turn = normal[y, x] - normal[qy, qx]
                    away = math.log(depth[y, x]) - math.log(depth[qy, qx])
                    weight = B3[ky + 2] * B3[kx + 2]
                    weight *= math.exp(-(light @ light) / (phi_light / 2**i))
                    weight *= math.exp(-(turn @ turn) / (2**i) ** 2 / phi_normal)
                    weight *= math.exp(-(away**2) / phi_depth)
                    total = total + weight * before[qy, qx]
                    weights += weight
            image[y, x] = total / weights
    return np.where(solid[..., None], image * divisor, noisy)


def _recall(memory, y, x, depth, normal, motion):
    """Colour, moments and length where this surface was, or None."""
    if memory is None:
        return None
    h, w = memory[2].shape
    if motion is None:
        return _remembered(memory, y, x) if memory[2][y, x] > 0 else None
    px, py = x + motion[y, x, 0], y + motion[y, x, 1]
    left, top = math.floor(px), math.floor(py)
    fx, fy = px - left, py - top
    bilinear = [
        (top, left, (1 - fy) * (1 - fx)),
        (top, left + 1, (1 - fy) * fx),
        (top + 1, left, fy * (1 - fx)),
        (top + 1, left + 1, fy * fx),
    ]
    cy, cx = math.floor(py + 0.5), math.floor(px + 0.5)
    around = [(cy + j, cx + i, 1.0) for j in (-1, 0, 1) for i in (-1, 0, 1)]
    for taps in (bilinear, around):
        total, weights = 0, 0
        for ty, tx, weight in taps:
            if not (0 <= ty < h and 0 <= tx < w) or memory[2][ty, tx] == 0:
                continue
            if abs(memory[3][ty, tx] - depth) > 0.1 * depth or memory[4][ty, tx] @ normal < 0.9:
                continue
            total = total + weight * _remembered(memory, ty, tx)
            weights += weight
        if weights >= 0.01:
            return total / weights
    return None


def _remembered(memory, y, x):
    return np.array([*memory[0][y, x], *memory[1][y, x], memory[2][y, x]])


def _slope(depth, solid):
    """Change of depth from pixel to pixel, of the two sides the lesser, for each axis."""
    h, w = depth.shape
    slope = np.zeros((h, w))
    for y, x in np.argwhere(solid):
        for sides in (((y, x - 1), (y, x + 1)), ((y - 1, x), (y + 1, x))):
            inside = [(j, i) for j, i in sides if 0 <= j < h and 0 <= i < w and solid[j, i]]
            slope[y, x] += min((abs(depth[y, x] - depth[q]) for q in inside), default=0)
        slope[y, x] = max(slope[y, x], 1e-4 * depth[y, x])
    return slope


def _window(y, x, reach, step, colour, width, depth, normal, slope, solid):
    """Weights of the neighbours of a pixel, without a kernel, and where they are."""
    h, w = depth.shape
    grid = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1) * step
    ys, xs = grid[0] + y, grid[1] + x
    inside = (ys >= 0) & (ys < h) & (xs >= 0) & (xs < w)
    inside[inside] &= solid[ys[inside], xs[inside]]
    ys, xs = ys[inside], xs[inside]
    far = np.hypot(ys - y, xs - x)
    lum = colour @ LUMINANCE
    by_depth = np.abs(depth[ys, xs] - depth[y, x]) / np.maximum(slope[y, x] * far, 1e-12)
    by_light = np.abs(lum[ys, xs] - lum[y, x]) / width
    by_normal = np.maximum(normal[ys, xs] @ normal[y, x], 0) ** 128
    weights = np.exp(-by_depth) * np.exp(-by_light) * by_normal
    weights[far == 0] = 1
    return weights, ys, xs


def _wavelet(i, colour, variance, sigma, depth, normal, slope, solid):
    """One pass with holes of 2^i, for colour and for variance."""
    h, w = depth.shape
    ring = np.pad(variance, 1)
    gauss = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 16
    filtered, spread = colour.copy(), variance.copy()
    for y, x in np.argwhere(solid):
        width = sigma * math.sqrt((ring[y : y + 3, x : x + 3] * gauss).sum() + 1e-10)
        weights, ys, xs = _window(y, x, 2, 2**i, colour, width, depth, normal, slope, solid)
        weights = weights * B3[(ys - y) // 2**i + 2] * B3[(xs - x) // 2**i + 2]
        filtered[y, x] = weights @ colour[ys, xs] / weights.sum()
        spread[y, x] = weights**2 @ variance[ys, xs] / weights.sum() ** 2
    return filtered, spread
