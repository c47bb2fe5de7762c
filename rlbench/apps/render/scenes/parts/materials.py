"""Materials of the test scenes as Mitsuba plugins, and procedural textures as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rlbench.apps.render.scenes.parts.shapes import Float32Array

Pixels = Float32Array  # h w 3, linear reflectance or radiance
Colour = tuple[float, float, float]


def rgb(red: float, green: float, blue: float) -> dict[str, Any]:
    """A constant linear RGB colour."""
    return {"type": "rgb", "value": [red, green, blue]}


def diffuse_bsdf(reflectance: dict[str, Any]) -> dict[str, Any]:
    """A matte surface on both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def glossy_bsdf(reflectance: dict[str, Any], alpha: float) -> dict[str, Any]:
    """A coloured base under a clear coat of roughness `alpha`, on both sides."""
    coat = {"type": "roughplastic", "diffuse_reflectance": reflectance, "alpha": alpha}
    return {"type": "twosided", "bsdf": coat}


def metal_bsdf(reflectance: dict[str, Any], alpha: float) -> dict[str, Any]:
    """A conductor tinted by `reflectance`, with roughness `alpha`, on both sides."""
    plain = {"type": "roughconductor", "specular_reflectance": reflectance, "alpha": alpha}
    return {"type": "twosided", "bsdf": plain}


def polished_bsdf(reflectance: dict[str, Any]) -> dict[str, Any]:
    """A coloured base under a perfectly smooth clear coat, on both sides."""
    return {"type": "twosided", "bsdf": {"type": "plastic", "diffuse_reflectance": reflectance}}


def bitmap_texture(pixels: ArrayLike, filter_type: str = "bilinear") -> dict[str, Any]:
    """A repeating bitmap of linear values [h w 3] as a Mitsuba plugin that holds the array."""
    values = np.ascontiguousarray(pixels, np.float32)
    return {"type": "bitmap", "data": values, "raw": True, "filter_type": filter_type}


def palette_texture(colours: Sequence[Colour]) -> dict[str, Any]:
    """A texture with one texel for each colour; `paint` selects the colour of a shape."""
    return bitmap_texture(np.array(colours, np.float32)[None], "nearest")


def noise_pixels(random: np.random.Generator, size: int, falloff: float = 1.0) -> Pixels:
    """Repeating cloudy noise [size size 1] in [0, 1]: white noise times 1 / f^(1 + falloff)."""
    ring = np.fft.fftfreq(size)
    frequency = np.hypot(ring[:, None], ring[None]) * size
    spectrum = np.fft.fft2(random.normal(size=(size, size))) / np.maximum(frequency, 1) ** (
        1 + falloff
    )
    spectrum[0, 0] = 0
    cloud = np.fft.ifft2(spectrum).real
    cloud = 0.5 + cloud / (4.5 * cloud.std())
    return np.asarray(np.clip(cloud, 0, 1)[..., None], np.float32)


def mix_colours(a: Colour, b: Colour, weight: Pixels) -> Pixels:
    """Linear interpolation from colour a at weight 0 to colour b at weight 1; weight is [h w 1]."""
    return np.asarray(np.array(a) * (1 - weight) + np.array(b) * weight, np.float32)


def tile_pixels(
    random: np.random.Generator,
    colours: Sequence[Colour],
    joint_colour: Colour,
    count: tuple[int, int] = (8, 8),
    row_offset: float = 0.0,
    size: int = 256,
    joint_width: float = 0.08,
) -> Pixels:
    """Repeating rows of tiles or bricks [size size 3]; `count` is (rows, columns).

    Each tile has one of the colours. Odd rows are shifted by `row_offset` tiles. Joints are
    `joint_width` rows column_joint.
    """
    rows, columns = count
    at = (np.arange(size) + 0.5) / size
    y = np.broadcast_to(at[:, None] * rows, (size, size))
    row = np.floor(y).astype(int)
    x = at[None] * columns + row_offset * (row % 2)
    column = np.floor(x).astype(int) % columns
    pick = random.integers(len(colours), size=(rows, columns))
    shade = random.uniform(0.85, 1.1, (rows, columns, 1))
    face = (np.array(colours)[pick] * shade)[row, column]
    column_joint = joint_width * columns / rows
    inside = (np.abs(y % 1 - 0.5) < 0.5 - joint_width / 2) & (
        np.abs(x % 1 - 0.5) < 0.5 - column_joint / 2
    )
    grain = 0.85 + 0.3 * noise_pixels(random, size, 0.3)
    return np.asarray(np.where(inside[..., None], face, np.array(joint_colour)) * grain, np.float32)
