"""Random materials: matte, plastic, metal, mirror, glass, and thin leaves and cloth."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from rlbench.render.scene import MitsubaDict
from rlbench.scenes.generator.textures import random_colour, random_texture, rgb_texture

SHELL_ALBEDO = {  # darkest albedo by part of the place
    "wall": 0.55,
    "floor": 0.35,
    "column": 0.4,
    "ground": 0.3,
    "block": 0.25,
    "wood": 0.2,
}


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
