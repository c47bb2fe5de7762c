"""SVGF and EAW as plain loops in double precision, written from the papers.

Images are [h w c] arrays. Nothing is shared with the methods but their constants.
"""

from __future__ import annotations

import math

import numpy as np

B3 = np.array([1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16])
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def area_albedo(albedo):
    """The demodulation albedo: binomial mean over the reflecting pixels of a 3 x 3 window."""
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


def svgf(
    noisy, gbuffer, history, alpha=0.2, alpha_moments=0.2, passes=5, feedback_tap=0, sigma=4.0
):
    """Image and history of one frame; `history` is None before the first."""
    albedo, normal, depth, motion = gbuffer
    h, w = depth.shape
    surface = np.isfinite(depth) & (albedo.max(-1) > 0)
    divisor = area_albedo(albedo)
    now = noisy / divisor

    # temporal accumulation
    colour = np.zeros((h, w, 3))
    moments = np.zeros((h, w, 2))
    length = np.zeros((h, w))
    variance = np.zeros((h, w))
    for y, x in np.argwhere(surface):
        old = _reproject(history, y, x, depth[y, x], normal[y, x], motion)
        lum = now[y, x] @ LUMINANCE
        current = np.array([*now[y, x], lum, lum**2])
        length[y, x] = 1 if old is None else min(old[5] + 1, 32)
        if old is not None:
            a, am = max(alpha, 1 / length[y, x]), max(alpha_moments, 1 / length[y, x])
            alphas = np.array([a, a, a, am, am])
            current = alphas * current + (1 - alphas) * old[:5]
        colour[y, x], moments[y, x] = current[:3], current[3:]
        variance[y, x] = max(0, current[4] - current[3] ** 2)

    # spatial variance estimate of short histories
    slope = _slope(depth, surface)
    start = colour.copy()
    for y, x in np.argwhere(surface & (length < 4)):
        weights, ys, xs = _window(y, x, 3, 1, colour, sigma, depth, normal, slope, surface)
        mean = weights @ np.concatenate([colour, moments], -1)[ys, xs] / weights.sum()
        start[y, x] = mean[:3]
        variance[y, x] = max(0, mean[4] - mean[3] ** 2) * 4 / length[y, x]

    filtered, feedback_image = start, None
    for i in range(passes):
        filtered, variance = _wavelet(i, filtered, variance, sigma, depth, normal, slope, surface)
        feedback_image = filtered if i == feedback_tap else feedback_image
    image = np.where(surface[..., None], filtered * divisor, noisy)
    return image, (feedback_image, moments, length, depth, normal)


def eaw(noisy, gbuffer, phi_light, phi_normal, phi_depth, passes=5):
    """One frame; `phi_light` is the width of the first pass."""
    albedo, normal, depth, _ = gbuffer
    h, w = depth.shape
    surface = np.isfinite(depth) & (albedo.max(-1) > 0)
    divisor = area_albedo(albedo)
    image = noisy / divisor
    for i in range(passes):
        before, image = image, image.copy()
        for y, x in np.argwhere(surface):
            total, weights = 0, 0
            for ky in range(-2, 3):
                for kx in range(-2, 3):
                    qy, qx = y + ky * 2**i, x + kx * 2**i
                    if not (0 <= qy < h and 0 <= qx < w and surface[qy, qx]):
                        continue
                    light = np.log1p(before[y, x]) - np.log1p(before[qy, qx])
                    turn = normal[y, x] - normal[qy, qx]
                    log_depth_difference = math.log(depth[y, x]) - math.log(depth[qy, qx])
                    weight = B3[ky + 2] * B3[kx + 2]
                    weight *= math.exp(-(light @ light) / (phi_light / 2**i))
                    weight *= math.exp(-(turn @ turn) / (2**i) ** 2 / phi_normal)
                    weight *= math.exp(-(log_depth_difference**2) / phi_depth)
                    total = total + weight * before[qy, qx]
                    weights += weight
            image[y, x] = total / weights
    return np.where(surface[..., None], image * divisor, noisy)


def _reproject(history, y, x, depth, normal, motion):
    """Colour, moments and length of this surface in the previous frame, or None."""
    if history is None:
        return None
    h, w = history[2].shape
    if motion is None:
        return _history_at(history, y, x) if history[2][y, x] > 0 else None
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
            if not (0 <= ty < h and 0 <= tx < w) or history[2][ty, tx] == 0:
                continue
            if abs(history[3][ty, tx] - depth) > 0.1 * depth or history[4][ty, tx] @ normal < 0.9:
                continue
            total = total + weight * _history_at(history, ty, tx)
            weights += weight
        if weights >= 0.01:
            return total / weights
    return None


def _history_at(history, y, x):
    return np.array([*history[0][y, x], *history[1][y, x], history[2][y, x]])


def _slope(depth, surface):
    """Depth change per pixel: the lesser of both one-sided differences, summed over the axes."""
    h, w = depth.shape
    slope = np.zeros((h, w))
    for y, x in np.argwhere(surface):
        for sides in (((y, x - 1), (y, x + 1)), ((y - 1, x), (y + 1, x))):
            inside = [(j, i) for j, i in sides if 0 <= j < h and 0 <= i < w and surface[j, i]]
            slope[y, x] += min((abs(depth[y, x] - depth[q]) for q in inside), default=0)
        slope[y, x] = max(slope[y, x], 1e-4 * depth[y, x])
    return slope


def _window(y, x, reach, step, colour, width, depth, normal, slope, surface):
    """Edge-stopping weights of a pixel's neighbours, without a kernel, and their positions."""
    h, w = depth.shape
    grid = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1) * step
    ys, xs = grid[0] + y, grid[1] + x
    inside = (ys >= 0) & (ys < h) & (xs >= 0) & (xs < w)
    inside[inside] &= surface[ys[inside], xs[inside]]
    ys, xs = ys[inside], xs[inside]
    far = np.hypot(ys - y, xs - x)
    lum = colour @ LUMINANCE
    by_depth = np.abs(depth[ys, xs] - depth[y, x]) / np.maximum(slope[y, x] * far, 1e-12)
    by_light = np.abs(lum[ys, xs] - lum[y, x]) / width
    by_normal = np.maximum(normal[ys, xs] @ normal[y, x], 0) ** 128
    weights = np.exp(-by_depth) * np.exp(-by_light) * by_normal
    weights[far == 0] = 1
    return weights, ys, xs


def _wavelet(i, colour, variance, sigma, depth, normal, slope, surface):
    """One a-trous pass with a step of 2^i, of colour and variance."""
    h, w = depth.shape
    ring = np.pad(variance, 1)
    gauss = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 16
    filtered, filtered_variance = colour.copy(), variance.copy()
    for y, x in np.argwhere(surface):
        width = sigma * math.sqrt((ring[y : y + 3, x : x + 3] * gauss).sum() + 1e-10)
        weights, ys, xs = _window(y, x, 2, 2**i, colour, width, depth, normal, slope, surface)
        weights = weights * B3[(ys - y) // 2**i + 2] * B3[(xs - x) // 2**i + 2]
        filtered[y, x] = weights @ colour[ys, xs] / weights.sum()
        filtered_variance[y, x] = weights**2 @ variance[ys, xs] / weights.sum() ** 2
    return filtered, filtered_variance
