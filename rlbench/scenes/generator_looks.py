"""Looks for random scenes: procedural textures, materials, skies and lamps with known power."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from rlbench.render.scene import Mesh, Plugin
from rlbench.scenes.generator_shapes import Floats, Shape, merged, quad

BRIGHTNESS = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709 luminance of linear RGB
TILE = 128  # texels along each side of a texture


class Glow(NamedTuple):
    """Emissive mesh and the luminous flux that leaves it, in radiance x m2 x sr."""

    mesh: Mesh
    flux: float


def colour(rng: Generator, low: float = 0.15, high: float = 0.85, vivid: float = 0.7) -> Floats:
    """A random linear RGB colour between two brightest channels; `vivid` bounds saturation."""
    hue = rng.uniform(0, 1)
    wheel = np.abs((hue + np.array([0, 2, 1]) / 3) % 1 * 6 - 3) - 1
    saturation = rng.uniform(0, vivid)
    return np.asarray(
        rng.uniform(low, high) * (1 - saturation * (1 - np.clip(wheel, 0, 1))), dtype=float
    )


def rgb(value: Floats) -> Plugin:
    """A constant colour as a plugin."""
    return {"type": "rgb", "value": [float(v) for v in value]}


def texture(rng: Generator, low: float = 0.15, vivid: float = 0.7) -> Plugin:
    """A random tile of two colours: checker, stripes, bricks or cloudy noise."""
    pattern = (_checker, _stripes, _bricks, _noise)[rng.integers(4)](rng)
    one, two = colour(rng, max(low, 0.4), 0.85, vivid), colour(rng, 0.7 * low, 0.7, vivid)
    grain = 1 - rng.uniform(0, 0.25) * _noise(rng)
    tile = (two + pattern[..., None] * (one - two)) * grain[..., None]
    return {
        "type": "bitmap",
        "data": np.clip(tile, 0.02, 0.9).astype(np.float32),
        "raw": True,
        "filter_type": "bilinear",
        "wrap_mode": "repeat",
    }


def diffuse(rng: Generator, low: float = 0.15, vivid: float = 0.7) -> Plugin:
    """Paint of one colour."""
    return {"type": "diffuse", "reflectance": rgb(colour(rng, low, 0.85, vivid))}


def textured(rng: Generator, low: float = 0.15, vivid: float = 0.7) -> Plugin:
    """Matte with a random texture."""
    return {"type": "diffuse", "reflectance": texture(rng, low, vivid)}


def plastic(rng: Generator, low: float = 0.15, vivid: float = 0.7) -> Plugin:
    """Coloured or textured plastic, from almost polished to satin."""
    base = texture(rng, low, vivid)
    if rng.random() < 0.6:
        base = rgb(colour(rng, low, 0.85, vivid))
    return {
        "type": "roughplastic",
        "diffuse_reflectance": base,
        "alpha": float(rng.uniform(0.06, 0.35)),
        "nonlinear": bool(rng.random() < 0.5),
    }


def metal(rng: Generator) -> Plugin:
    """A tinted metal, brushed to satin."""
    return {
        "type": "roughconductor",
        "material": "none",
        "specular_reflectance": rgb(colour(rng, 0.6, 0.92, vivid=0.5)),
        "alpha": float(0.12 * 4 ** rng.uniform(0, 1)),
        "distribution": "ggx",
    }


def mirror(rng: Generator) -> Plugin:
    """A perfect mirror, lightly tinted."""
    tint = colour(rng, 0.75, 0.92, vivid=0.2)
    return {"type": "conductor", "material": "none", "specular_reflectance": rgb(tint)}


def glass(rng: Generator) -> Plugin:
    """Clear glass or water, for closed solids or for a surface of water seen from above."""
    return {"type": "dielectric", "int_ior": float(rng.uniform(1.3, 1.55)), "ext_ior": 1.0}


def leaf(rng: Generator) -> Plugin:
    """A thin sheet that is matte on both sides: green, autumn, or any colour."""
    tint = colour(rng, 0.2, 0.6, vivid=0.8)
    if rng.random() < 0.6:
        tint = rng.uniform(0.2, 0.5) * np.array([rng.uniform(0.2, 1), 1, rng.uniform(0.1, 0.4)])
    return twosided({"type": "diffuse", "reflectance": rgb(tint)})


def twosided(material: Plugin) -> Plugin:
    """The same opaque material on both sides of thin geometry."""
    return {"type": "twosided", "bsdf": material}


def panels(name: str, shapes: list[Shape], tint: Floats) -> Glow:
    """Lamps of one radiance [3] as one mesh."""
    shape = merged(shapes)
    flux = np.pi * _area(shape) * float(tint @ BRIGHTNESS)
    return Glow(_emissive(name, shape, shape.uv, rgb(tint)), flux)


def bulbs(rng: Generator, centres: Floats, normals: Floats, sizes: Floats) -> Glow:
    """Many small square lamps, each of its own colour: one mesh, one texel of an atlas a lamp.

    centres and normals [n 3], sides [n] in metres. Every texel is covered by exactly one lamp, so
    that a texture-space sampler always lands on the mesh.
    """
    count = len(centres)
    cols = next(c for c in range(int(np.sqrt(count)), 0, -1) if count % c == 0)
    rows = count // cols
    hues = np.stack([colour(rng, 0.7, 1, vivid=0.85) for _ in range(int(rng.integers(2, 7)))])
    power = 6 * 2 ** rng.uniform(-1, 1, (count, 1))
    atlas = (hues[rng.integers(len(hues), size=count)] * power).reshape(rows, cols, 3)
    corners, uv = [], []
    for k, (centre, normal, size) in enumerate(zip(centres, normals, sizes, strict=True)):
        side = np.cross(normal, [1, 0, 0] if abs(normal[0]) < 0.7 else [0, 1, 0])
        side *= size / 2 / np.linalg.norm(side)
        up = np.cross(normal, side)
        corners.append([centre - side - up, centre + side - up, centre + side + up])
        corners[-1].append(centre - side + up)
        u, v = k % cols, k // cols
        uv += [[u, v], [u + 1, v], [u + 1, v + 1], [u, v + 1]]
    shape = merged([quad(c) for c in corners])
    bitmap = {"type": "bitmap", "data": atlas.astype(np.float32), "raw": True}
    bitmap |= {"filter_type": "nearest", "wrap_mode": "clamp"}
    flux = np.pi * float(np.sum(sizes**2)) * float(atlas.mean((0, 1)) @ BRIGHTNESS)
    return Glow(_emissive("bulbs", shape, np.array(uv) / [cols, rows], bitmap), flux)


def _emissive(name: str, shape: Shape, uv: Floats, radiance: Plugin) -> Mesh:
    return Mesh(
        name,
        shape.vertices.astype(np.float32),
        shape.faces.astype(np.uint32),
        {"type": "diffuse", "reflectance": rgb(np.full(3, 0.1))},
        uv.astype(np.float32),
        {"type": "area", "radiance": radiance},
    )


def _area(shape: Shape) -> float:
    p, q, r = (shape.vertices[shape.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(q - p, r - p), axis=-1).sum() / 2)


def _checker(rng: Generator) -> Floats:
    cells = int(rng.choice([1, 2, 4]))
    k = np.arange(TILE) * 2 * cells // TILE
    return np.asarray((k[:, None] + k) % 2, float)


def _stripes(rng: Generator) -> Floats:
    count, share = int(rng.choice([2, 4, 8])), rng.uniform(0.2, 0.8)
    line = np.asarray((np.arange(TILE) * count / TILE) % 1 < share, float)
    rows = np.broadcast_to(line, (TILE, TILE))
    return rows.T if rng.random() < 0.5 else rows


def _bricks(rng: Generator) -> Floats:
    v, u = np.mgrid[:TILE, :TILE] / TILE
    row = np.floor(v * 8)
    u = (u * 4 + row % 2 / 2) % 4
    gap = rng.uniform(0.02, 0.06)
    inside = (u % 1 > gap) & (v * 8 % 1 > 2 * gap)
    tone = rng.uniform(0.5, 1, (8, 4))[row.astype(int), u.astype(int)]
    return np.asarray(inside * tone, float)


def _noise(rng: Generator, size: int = TILE) -> Floats:
    """Cloudy noise in 0..1 that tiles: white noise filtered by frequency ** -slope."""
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)) * size
    spectrum = np.fft.fft2(rng.normal(size=(size, size)))
    cloud = np.fft.ifft2(spectrum / np.maximum(f, 2) ** rng.uniform(1, 2)).real
    return np.asarray((cloud - cloud.min()) / np.ptp(cloud))
