"""Random materials of generated scenes, and the tiling textures that they wear."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from rlbench.apps.render.scene import MitsubaDict
from rlbench.apps.render.scenes.parts.shapes import Float64Array

TEXTURE_SIZE = 128  # texels along each side
SHELL_ALBEDO = {  # darkest albedo by part of the place
    "wall": 0.55,
    "floor": 0.35,
    "column": 0.4,
    "ground": 0.3,
    "block": 0.25,
    "wood": 0.2,
}


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


def draw_materials(rng: Generator, without_mirrors: bool) -> dict[str, MitsubaDict]:
    """A material for every name that a part of a scene can have."""
    plain = (diffuse_bsdf, textured_bsdf, plastic_bsdf)
    finishes = [
        *plain,
        metal_bsdf,
        plastic_bsdf if without_mirrors else mirror_bsdf,
    ]
    order = rng.permutation(len(finishes))
    solids = {f"solid{k}": finishes[order[k]](rng) for k in range(3)}
    movers = {f"mover{k}": finishes[order[k + 3]](rng) for k in range(2)}
    shell = {name: plain[rng.integers(3)](rng, SHELL_ALBEDO[name], 0.4) for name in SHELL_ALBEDO}
    thin = {
        "leaf": leaf_bsdf(rng),
        "cloth": two_sided(textured_bsdf(rng)),
    }
    clear = {"glass": glass_bsdf(rng), "water": glass_bsdf(rng)}
    return solids | movers | shell | thin | clear


def diffuse_bsdf(rng: Generator, darkest: float = 0.15, max_saturation: float = 0.7) -> MitsubaDict:
    """A matte surface of one colour."""
    return {
        "type": "diffuse",
        "reflectance": rgb_texture(random_colour(rng, darkest, 0.85, max_saturation)),
    }


def textured_bsdf(
    rng: Generator, darkest: float = 0.15, max_saturation: float = 0.7
) -> MitsubaDict:
    """A matte surface with a random texture."""
    return {"type": "diffuse", "reflectance": random_texture(rng, darkest, max_saturation)}


def plastic_bsdf(rng: Generator, darkest: float = 0.15, max_saturation: float = 0.7) -> MitsubaDict:
    """Coloured or textured plastic, from nearly polished to satin."""
    base = random_texture(rng, darkest, max_saturation)
    if rng.random() < 0.6:
        base = rgb_texture(random_colour(rng, darkest, 0.85, max_saturation))
    return {
        "type": "roughplastic",
        "diffuse_reflectance": base,
        "alpha": float(rng.uniform(0.06, 0.35)),
        "nonlinear": bool(rng.random() < 0.5),
    }


def metal_bsdf(rng: Generator) -> MitsubaDict:
    """A tinted rough metal, from brushed to satin."""
    return {
        "type": "roughconductor",
        "material": "none",
        "specular_reflectance": rgb_texture(random_colour(rng, 0.6, 0.92, max_saturation=0.5)),
        "alpha": float(0.12 * 4 ** rng.uniform(0, 1)),
        "distribution": "ggx",
    }


def mirror_bsdf(rng: Generator) -> MitsubaDict:
    """A perfect mirror with a light tint."""
    tint = random_colour(rng, 0.75, 0.92, max_saturation=0.2)
    return {"type": "conductor", "material": "none", "specular_reflectance": rgb_texture(tint)}


def glass_bsdf(rng: Generator) -> MitsubaDict:
    """Clear glass or water, for closed solids and for a water surface seen from above."""
    return {"type": "dielectric", "int_ior": float(rng.uniform(1.3, 1.55)), "ext_ior": 1.0}


def leaf_bsdf(rng: Generator) -> MitsubaDict:
    """A thin sheet, matte on both sides: green, autumnal, or any colour."""
    tint = random_colour(rng, 0.2, 0.6, max_saturation=0.8)
    if rng.random() < 0.6:
        tint = rng.uniform(0.2, 0.5) * np.array([rng.uniform(0.2, 1), 1, rng.uniform(0.1, 0.4)])
    return two_sided({"type": "diffuse", "reflectance": rgb_texture(tint)})


def two_sided(material: MitsubaDict) -> MitsubaDict:
    """The same opaque material on both sides of a thin surface."""
    return {"type": "twosided", "bsdf": material}
