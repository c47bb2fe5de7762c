"""Finishes of interiors: textures of high contrast, metals, lacquer, glass, mirrors, lampshades.

A finish is the name of a material. All pieces of one finish become one mesh; in palette finishes,
each piece selects its colour by its texture coordinates.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from rlbench.apps.render.scene import MitsubaDict
from rlbench.apps.render.scenes.generator.materials import (
    PATTERNS,
    TEXTURE_SIZE,
    cloud_noise,
    leaf_bsdf,
    mirror_bsdf,
    plastic_bsdf,
    random_colour,
    random_texture,
    rgb_texture,
    tile_texture,
    two_sided,
)
from rlbench.apps.render.scenes.parts.shapes import Float64Array

FLOORS = ("boards", "boards", "tiles", "tiles", "carpet", "concrete", "marble", "print")
METALS = ("Cu", "Au", "Al", "Cr", "Ag", "W")  # conductors of Mitsuba
WALL_ALBEDO = {"bright": (0.65, 0.85), "medium": (0.4, 0.65), "dark": (0.12, 0.35)}  # by tone
PALETTE_SIZE = 8  # colours of a palette finish
PICTURES = 4  # rows and columns of the atlas of pictures
PALETTED = ("paint", "lacquer")
STRETCHED = (*PALETTED, "print", "rug")  # texture coordinates are not metres


def draw_finishes(
    rng: Generator, tone: str, floor: str, metals: tuple[str, str]
) -> dict[str, MitsubaDict]:
    """A material for every finish. `tone` is a key of WALL_ALBEDO, `floor` one of FLOORS."""
    lacquer = _glossy(_draw_palette(rng), 0.04 * 8 ** rng.uniform(0, 1))
    return {
        "wall": two_sided(_draw_wall(rng, tone)),
        "floor": two_sided(_draw_floor(rng, floor)),
        "wood": two_sided(_glossy(_draw_wood(rng), rng.uniform(0.1, 0.4))),
        "fabric": two_sided({"type": "diffuse", "reflectance": draw_print(rng)}),
        "paint": two_sided({"type": "diffuse", "reflectance": _draw_palette(rng)}),
        "lacquer": two_sided(lacquer),
        "print": two_sided({"type": "diffuse", "reflectance": _draw_pictures(rng)}),
        "rug": two_sided({"type": "diffuse", "reflectance": _draw_rug(rng)}),
        "metal": two_sided(_draw_metal(rng, metals[0])),
        "steel": two_sided(_draw_metal(rng, metals[1])),
        "mirror": two_sided(mirror_bsdf(rng)),
        "glass": {"type": "dielectric", "int_ior": float(rng.uniform(1.3, 1.55)), "ext_ior": 1.0},
        "pane": {"type": "thindielectric"},
        "leaf": leaf_bsdf(rng),
        "shade": _draw_shade(rng),
        "mover0": two_sided(_draw_metal(rng, metals[1])),
        "mover1": two_sided(plastic_bsdf(rng, 0.05)),
        "cloth": two_sided({"type": "diffuse", "reflectance": draw_print(rng)}),
    }


def draw_print(rng: Generator) -> MitsubaDict:
    """A tiling texture of a dark and a bright colour."""
    pattern = (*PATTERNS, _text_pattern)[rng.integers(len(PATTERNS) + 1)](rng)
    return tile_texture(_mix(pattern, *_draw_contrast(rng)))


def _draw_contrast(rng: Generator) -> tuple[Float64Array, Float64Array]:
    """A dark and a bright colour [3], in random order."""
    pair = random_colour(rng, 0.03, 0.15, 0.8), random_colour(rng, 0.6, 0.88, 0.6)
    return pair if rng.random() < 0.5 else pair[::-1]


def _mix(weight: Float64Array, first: Float64Array, second: Float64Array) -> Float64Array:
    """Pixels [h w 3] from `first` at weight 0 to `second` at 1."""
    return first + weight[..., None] * (second - first)


def _draw_wall(rng: Generator, tone: str) -> MitsubaDict:
    """Matte paint, satin paint, or wallpaper and bricks."""
    low, high = WALL_ALBEDO[tone]
    colour = random_colour(rng, low, high, 0.25)
    kind = rng.choice(("matte", "matte", "satin", "paper"))
    if kind == "satin":
        return _glossy(rgb_texture(colour), rng.uniform(0.2, 0.4))
    if kind == "paper":
        pattern = PATTERNS[rng.integers(1, len(PATTERNS))](rng)
        paper = tile_texture(_mix(pattern, rng.uniform(0.3, 0.8) * colour, colour))
        return {"type": "diffuse", "reflectance": paper}
    return {"type": "diffuse", "reflectance": rgb_texture(colour)}


def _draw_floor(rng: Generator, floor: str) -> MitsubaDict:
    if floor == "boards":
        return _glossy(_draw_wood(rng), rng.uniform(0.06, 0.25))
    if floor == "tiles":
        return _glossy(draw_print(rng), rng.uniform(0.03, 0.15))
    if floor == "concrete":
        grey = rng.uniform(0.2, 0.6) * np.ones(3)
        return _glossy(tile_texture(_mix(cloud_noise(rng), 0.6 * grey, grey)), 0.3)
    if floor == "marble":
        veins = np.abs(2 * cloud_noise(rng) - 1) ** 0.5
        return {"type": "plastic", "diffuse_reflectance": _tile(veins, *_draw_contrast(rng))}
    texture = draw_print(rng) if floor == "print" else random_texture(rng, 0.1, 0.5)
    return {"type": "diffuse", "reflectance": texture}


def _tile(weight: Float64Array, first: Float64Array, second: Float64Array) -> MitsubaDict:
    return tile_texture(_mix(weight, first, second))


def _glossy(base: MitsubaDict, alpha: float) -> MitsubaDict:
    """A base under a rough coat."""
    return {"type": "roughplastic", "diffuse_reflectance": base, "alpha": float(alpha)}


def _draw_metal(rng: Generator, metal: str) -> MitsubaDict:
    """A rough conductor, from nearly polished to dull."""
    alpha = float(0.05 * 10 ** rng.uniform(0, 1))
    return {"type": "roughconductor", "material": metal, "alpha": alpha, "distribution": "ggx"}


def _draw_shade(rng: Generator) -> MitsubaDict:
    """Thin paper or linen, which half of the light passes through."""
    tint = random_colour(rng, 0.6, 0.9, 0.4)
    return {
        "type": "principledthin",
        "base_color": rgb_texture(tint),
        "diff_trans": float(rng.uniform(0.7, 1.2)),
        "roughness": 0.7,
    }


def _draw_palette(rng: Generator) -> MitsubaDict:
    """PALETTE_SIZE texels from nearly black to nearly white."""
    levels = np.geomspace(0.03, 0.85, PALETTE_SIZE)
    colours = [random_colour(rng, level, level, 0.85) for level in levels]
    return tile_texture(np.array(colours)[None], "nearest")


def _draw_wood(rng: Generator) -> MitsubaDict:
    """Planks of stretched grain, in tones from walnut to birch."""
    along = np.arange(TEXTURE_SIZE)
    grain = cloud_noise(rng)[along * int(rng.integers(3, 6)) % TEXTURE_SIZE][:, along // 8]
    plank = along * 6 // TEXTURE_SIZE
    tone = rng.uniform(0.6, 1, 6)[plank] * (np.diff(plank, append=0) == 0)  # with dark joints
    birch = rng.uniform(0.15, 0.7) * np.array([1, rng.uniform(0.6, 0.8), rng.uniform(0.3, 0.55)])
    return tile_texture(_mix(grain.T, 0.35 * birch, birch) * tone[:, None, None])


def _draw_rug(rng: Generator) -> MitsubaDict:
    """Nested frames around diamonds or another pattern, in three colours."""
    v, u = np.abs(np.mgrid[:TEXTURE_SIZE, :TEXTURE_SIZE] * 2 / TEXTURE_SIZE - 1)
    edge = np.maximum(u, v)
    count = int(rng.integers(4, 12))
    frames = np.floor(edge * count) % 2
    field = np.floor((u + v) * rng.uniform(2, 7)) % 2
    if rng.random() < 0.6:
        field = PATTERNS[rng.integers(len(PATTERNS))](rng)
    pattern = np.where(edge > rng.uniform(0.4, 0.85), frames, field)
    dark, bright = _draw_contrast(rng)
    pixels = np.where(edge[..., None] > 0.92, random_colour(rng), _mix(pattern, dark, bright))
    return tile_texture(pixels)


def _draw_pictures(rng: Generator) -> MitsubaDict:
    """An atlas of PICTURES x PICTURES prints, texts and clouds."""
    kinds = (*PATTERNS, _text_pattern, cloud_noise, cloud_noise)
    rows = [
        np.concatenate(
            [
                _mix(kinds[rng.integers(len(kinds))](rng), *_draw_contrast(rng))
                for _ in range(PICTURES)
            ],
            1,
        )
        for _ in range(PICTURES)
    ]
    return tile_texture(np.concatenate(rows))


def _text_pattern(rng: Generator) -> Float64Array:
    """Lines of random words: blocks of ink, three quarters of them letters, between margins."""
    lines, letters = int(rng.choice([8, 16, 32])), int(rng.choice([32, 64]))
    ink = rng.random((lines, letters)) < 0.75
    ink &= rng.random((lines, letters)) < rng.uniform(0.5, 1)
    ink[:, letters - int(rng.integers(1, letters // 3)) :] &= rng.random((lines, 1)) < 0.5
    v, u = np.mgrid[:TEXTURE_SIZE, :TEXTURE_SIZE]
    is_line = v * lines * 2 // TEXTURE_SIZE % 2
    return np.asarray(
        1.0 - is_line * ink[v * lines // TEXTURE_SIZE, u * letters // TEXTURE_SIZE], float
    )
