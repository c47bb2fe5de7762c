"""Random colours and tiling textures: checkers, stripes, bricks, cloudy noise."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from rlbench.render.scene import MitsubaDict
from rlbench.scenes.parts.shape import Float64Array

TEXTURE_SIZE = 128  # texels along each side


def random_colour(
    rng: Generator, darkest: float = 0.15, brightest: float = 0.85, max_saturation: float = 0.7
) -> Float64Array:
    """A random linear RGB colour [3].

    Its brightest channel lies between `darkest` and `brightest`, all in [0, 1].
    """
    hue = rng.uniform(0, 1)
    wheel = np.abs((hue + np.array([0, 2, 1]) / 3) % 1 * 6 - 3) - 1
    saturation = rng.uniform(0, max_saturation)
    return np.asarray(
        rng.uniform(darkest, brightest) * (1 - saturation * (1 - np.clip(wheel, 0, 1))), dtype=float
    )


def rgb_texture(value: Float64Array) -> MitsubaDict:
    """A constant linear RGB colour [3] as a Mitsuba plugin."""
    return {"type": "rgb", "value": [float(v) for v in value]}


def random_texture(
    rng: Generator, darkest: float = 0.15, max_saturation: float = 0.7
) -> MitsubaDict:
    """A random tiling texture of two colours: checker, stripes, bricks or cloudy noise."""
    pattern = PATTERNS[rng.integers(len(PATTERNS))](rng)
    first, second = (
        random_colour(rng, max(darkest, 0.4), 0.85, max_saturation),
        random_colour(rng, 0.7 * darkest, 0.7, max_saturation),
    )
    grain = 1 - rng.uniform(0, 0.25) * cloud_noise(rng)
    tile = (second + pattern[..., None] * (first - second)) * grain[..., None]
    return tile_texture(tile)


def tile_texture(tile: Float64Array, filter_type: str = "bilinear") -> MitsubaDict:
    """A repeating bitmap of linear reflectances [h w 3], clipped to [0.02, 0.9]."""
    return {
        "type": "bitmap",
        "data": np.clip(tile, 0.02, 0.9).astype(np.float32),
        "raw": True,
        "filter_type": filter_type,
        "wrap_mode": "repeat",
    }


def _checker_pattern(rng: Generator) -> Float64Array:
    cells = int(rng.choice([1, 2, 4]))
    k = np.arange(TEXTURE_SIZE) * 2 * cells // TEXTURE_SIZE
    return np.asarray((k[:, None] + k) % 2, float)


def _stripe_pattern(rng: Generator) -> Float64Array:
    count, share = int(rng.choice([2, 4, 8])), rng.uniform(0.2, 0.8)
    line = np.asarray((np.arange(TEXTURE_SIZE) * count / TEXTURE_SIZE) % 1 < share, float)
    rows = np.broadcast_to(line, (TEXTURE_SIZE, TEXTURE_SIZE))
    return rows.T if rng.random() < 0.5 else rows


def _brick_pattern(rng: Generator) -> Float64Array:
    v, u = np.mgrid[:TEXTURE_SIZE, :TEXTURE_SIZE] / TEXTURE_SIZE
    row = np.floor(v * 8)
    u = (u * 4 + row % 2 / 2) % 4
    joint = rng.uniform(0.02, 0.06)
    inside = (u % 1 > joint) & (v * 8 % 1 > 2 * joint)
    shade = rng.uniform(0.5, 1, (8, 4))[row.astype(int), u.astype(int)]
    return np.asarray(inside * shade, float)


def cloud_noise(rng: Generator, size: int = TEXTURE_SIZE) -> Float64Array:
    """Cloudy noise in [0, 1] that tiles: white noise filtered by frequency ** -slope."""
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)) * size
    spectrum = np.fft.fft2(rng.normal(size=(size, size)))
    cloud = np.fft.ifft2(spectrum / np.maximum(frequency, 2) ** rng.uniform(1, 2)).real
    return np.asarray((cloud - cloud.min()) / np.ptp(cloud))


PATTERNS = (_checker_pattern, _stripe_pattern, _brick_pattern, cloud_noise)  # [t t] in [0, 1]
