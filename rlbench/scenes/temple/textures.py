"""Textures of the temple: marble, timber, inlaid pavement and woven banners."""

from __future__ import annotations

from typing import Any

import numpy as np

from rlbench.scenes.parts.textures import Pixels, bitmap_texture, mix_colours, noise_pixels

CREAM, ROSE = (0.66, 0.58, 0.45), (0.50, 0.24, 0.16)
GREEN, DARK = (0.07, 0.14, 0.10), (0.05, 0.04, 0.04)


def marble_pixels(random: np.random.Generator, size: int = 256) -> Pixels:
    """Repeating dark marble with pale veins [size size 3]."""
    vein = np.abs(noise_pixels(random, size, 0.8) - 0.5) * 2
    body = mix_colours((0.16, 0.04, 0.03), (0.30, 0.09, 0.07), noise_pixels(random, size, 0.2))
    return np.asarray(body + 0.25 * np.exp(-((vein / 0.035) ** 2)), np.float32)


def wood_pixels(random: np.random.Generator, size: int = 256) -> Pixels:
    """Repeating dark timber with cloudy grain [size size 3]."""
    grain = noise_pixels(random, size, 0.6)
    fine = np.repeat(noise_pixels(random, size, -0.6)[::1, :1], size, axis=1)
    return mix_colours((0.15, 0.075, 0.035), (0.36, 0.20, 0.10), 0.6 * grain + 0.4 * fine)


def pavement_pixels(random: np.random.Generator) -> Pixels:
    """One bay of floor [256 832 3], 13 metres wide and 4 long: slabs, bands and a roundel."""
    y, x = np.indices((256, 832)) + 0.5
    x, y = np.abs(x / 64 - 6.5), np.abs(y / 64 - 2)
    flat = np.empty((256, 832, 3))
    flat[:] = np.where(((x // 0.65 + (y + 0.325) // 0.65) % 2 > 0)[..., None], CREAM, ROSE)
    nave = x < 2.7
    slab = (np.abs(x - y) % 0.7 < 0.35) ^ ((x + y) % 0.7 < 0.35)
    flat[nave] = np.where(slab[..., None], CREAM, (0.46, 0.39, 0.30))[nave]
    for radius, colour in ((1.62, DARK), (1.55, CREAM), (1.42, GREEN), (0.98, CREAM), (0.9, ROSE)):
        flat[np.hypot(x, y) < radius] = colour
    star = np.hypot(x, y) * (1 + 0.35 * np.cos(8 * np.arctan2(y, x))) < 0.55
    flat[star] = CREAM
    flat[nave & (np.hypot(x - 2.0, y - 2.0) < 0.62)] = GREEN
    flat[nave & (np.hypot(x - 2.0, y - 2.0) < 0.42)] = ROSE
    flat[(x > 2.7) & (x < 3.9)] = GREEN
    flat[(np.abs(x - 2.75) < 0.05) | (np.abs(x - 3.85) < 0.05)] = CREAM
    flat[(np.abs(x - 2.62) < 0.05) | (np.abs(x - 3.98) < 0.05)] = DARK
    cloud = np.concatenate([noise_pixels(random, 256, 0.3) for _ in range(4)], 1)[:, :832]
    return np.asarray(flat * (0.7 + 0.6 * cloud), np.float32)


def banner_texture() -> dict[str, Any]:
    """A red banner with gold bands and a sun; one repeat covers the banner."""
    y, x = (np.indices((256, 128)) + 0.5) / 128
    x, y = np.abs(x - 0.5) * 1.05, 2.5 * (1 - y / 2)
    cloth = np.empty((256, 128, 3))
    cloth[:] = (0.34, 0.025, 0.03)
    gold = (0.62, 0.38, 0.09)
    cloth[(np.abs(x - 0.43) < 0.025) | (np.abs(y - 2.2) < 0.03) | (np.abs(y - 0.12) < 0.03)] = gold
    angle, far = np.arctan2(y - 1.15, x), np.hypot(x, y - 1.15)
    cloth[(far < 0.30 + 0.05 * np.cos(12 * angle)) & (far > 0.2)] = gold
    cloth[far < 0.13] = gold
    cloth *= 0.9 + 0.1 * np.indices((256, 128)).sum(0)[..., None] % 2
    return bitmap_texture(cloth)
