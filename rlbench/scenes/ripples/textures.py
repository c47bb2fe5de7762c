"""Textures of the bath: a mosaic floor, and slabs of veined travertine."""

from __future__ import annotations

import numpy as np

from rlbench.scenes.parts.textures import Pixels, mix_colours, noise_pixels, tile_pixels


def mosaic_pixels(random: np.random.Generator, cells: int = 120, size: int = 960) -> Pixels:
    """A mosaic of wavy rings [size size 3], pale enough to show the caustics on it."""
    colours = np.array(
        [(0.50, 0.64, 0.60), (0.37, 0.58, 0.58), (0.21, 0.46, 0.51), (0.06, 0.23, 0.34)]
    )
    at = (np.arange(cells) + 0.5) / cells * 2 - 1
    x, y = np.meshgrid(at, at)
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    wave = 9 * radius + 0.55 * np.cos(16 * angle) * (radius > 0.2)
    band = np.array([3, 0, 1, 0, 2, 0, 0, 1, 3, 1, 0, 0, 2, 0])[np.floor(wave).astype(int)]
    border = np.maximum(np.abs(x), np.abs(y)) > 0.94
    stone = colours[np.where(border, 3, band)] * random.uniform(0.8, 1.12, (cells, cells, 1))
    fine = size // cells
    full = stone.repeat(fine, 0).repeat(fine, 1)
    joint = (np.arange(size) % fine == 0)[:, None] | (np.arange(size) % fine == 0)
    return np.asarray(np.where(joint[..., None], np.array([0.42, 0.46, 0.44]), full), np.float32)


def travertine_pixels(random: np.random.Generator) -> Pixels:
    """Slabs of warm travertine [512 512 3] with veins along the rows."""
    slabs = tile_pixels(
        random, [(0.54, 0.46, 0.36), (0.60, 0.52, 0.42)], (0.22, 0.18, 0.14), (3, 2), 0.5, 512, 0.02
    )
    cloud = noise_pixels(random, 512, 0.7)
    across = (np.arange(512) / 512)[:, None, None]
    vein = 0.5 + 0.5 * np.sin(2 * np.pi * (9 * across + 2.6 * cloud))
    return slabs * mix_colours((0.80, 0.76, 0.70), (1.08, 1.06, 1.04), np.asarray(vein, np.float32))
