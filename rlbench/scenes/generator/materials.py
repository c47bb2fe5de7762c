"""Looks for random scenes: procedural textures, materials, skies and lamps of known power."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from rlbench.render.scene import Mesh, MitsubaDict
from rlbench.scenes.generator.places import Floats, Place
from rlbench.scenes.parts.shapes import Shape, merge, quads, rotation_matrix, transform

BRIGHTNESS = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709 luminance of linear RGB
GREY = 0.45  # mean albedo that the light estimate assumes
TILE = 128  # texels along each side of a texture


@dataclass(frozen=True)
class Light:
    """Lamps and sky, and the mean radiance they are expected to give."""

    level: float
    sky: tuple[MitsubaDict, ...] = ()
    lamps: tuple[Mesh, ...] = ()
    sharp: bool = False  # would mirrors and glass make fireflies of it?


def colour(rng: Generator, low: float = 0.15, high: float = 0.85, vivid: float = 0.7) -> Floats:
    """A random linear RGB colour between two brightest channels; `vivid` bounds saturation."""
    hue = rng.uniform(0, 1)
    wheel = np.abs((hue + np.array([0, 2, 1]) / 3) % 1 * 6 - 3) - 1
    saturation = rng.uniform(0, vivid)
    return np.asarray(
        rng.uniform(low, high) * (1 - saturation * (1 - np.clip(wheel, 0, 1))), dtype=float
    )


def rgb(value: Floats) -> MitsubaDict:
    """A constant colour as a plugin."""
    return {"type": "rgb", "value": [float(v) for v in value]}


def texture(rng: Generator, low: float = 0.15, vivid: float = 0.7) -> MitsubaDict:
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


def diffuse(rng: Generator, low: float = 0.15, vivid: float = 0.7) -> MitsubaDict:
    """Paint of one colour."""
    return {"type": "diffuse", "reflectance": rgb(colour(rng, low, 0.85, vivid))}


def textured(rng: Generator, low: float = 0.15, vivid: float = 0.7) -> MitsubaDict:
    """Matte with a random texture."""
    return {"type": "diffuse", "reflectance": texture(rng, low, vivid)}


def plastic(rng: Generator, low: float = 0.15, vivid: float = 0.7) -> MitsubaDict:
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


def metal(rng: Generator) -> MitsubaDict:
    """A tinted metal, brushed to satin."""
    return {
        "type": "roughconductor",
        "material": "none",
        "specular_reflectance": rgb(colour(rng, 0.6, 0.92, vivid=0.5)),
        "alpha": float(0.12 * 4 ** rng.uniform(0, 1)),
        "distribution": "ggx",
    }


def mirror(rng: Generator) -> MitsubaDict:
    """A perfect mirror, lightly tinted."""
    tint = colour(rng, 0.75, 0.92, vivid=0.2)
    return {"type": "conductor", "material": "none", "specular_reflectance": rgb(tint)}


def glass(rng: Generator) -> MitsubaDict:
    """Clear glass or water, for closed solids or for a surface of water seen from above."""
    return {"type": "dielectric", "int_ior": float(rng.uniform(1.3, 1.55)), "ext_ior": 1.0}


def leaf(rng: Generator) -> MitsubaDict:
    """A thin sheet that is matte on both sides: green, autumn, or any colour."""
    tint = colour(rng, 0.2, 0.6, vivid=0.8)
    if rng.random() < 0.6:
        tint = rng.uniform(0.2, 0.5) * np.array([rng.uniform(0.2, 1), 1, rng.uniform(0.1, 0.4)])
    return twosided({"type": "diffuse", "reflectance": rgb(tint)})


def twosided(material: MitsubaDict) -> MitsubaDict:
    """The same opaque material on both sides of thin geometry."""
    return {"type": "twosided", "bsdf": material}


def light(rng: Generator, place: Place, kind: str) -> Light:
    """Sky and lamps of one kind, and the mean radiance that the grey place reflects."""
    sky, toward, sun, dome = _sky(rng, place, kind)
    lamps, flux = [], 0.0
    if kind == "bulbs":
        lamps, flux = [made := _bulbs(rng, place)], _flux(made)
    elif kind == "lamps" or (place.roof and rng.random() < 0.6):
        lamps, flux = [made := _lamps(rng, place, 1.0 if kind == "lamps" else 0.3)], _flux(made)
    if place.roof:  # as in an integrating sphere
        x, y = 2 * place.half[0], 2 * place.half[1]
        area = 2 * x * y + 2 * (x + y) * (place.top - place.floor)
        for hole in place.holes:
            slant = max(0.0, float(toward @ hole.outward))
            flux += 0.7 * hole.area * (np.pi * dome + sun * slant)
        level = flux * GREY / (np.pi * area * (1 - GREY))
    else:
        level = GREY * (flux / 180 / np.pi + 0.8 * dome + 0.7 * sun * toward[2] / np.pi)
    return Light(float(level), sky, tuple(lamps), sharp=kind in ("bulbs", "sunsky"))


def _sky(
    rng: Generator, place: Place, kind: str
) -> tuple[tuple[MitsubaDict, ...], Floats, float, float]:
    """Emitters, direction to the sun, irradiance of the sun and radiance of the sky dome."""
    around, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(0.35, 0.9)
    if place.holes:  # the sun shines in
        outward = place.holes[rng.integers(len(place.holes))].outward
        around = np.arctan2(outward[1], outward[0]) + rng.uniform(-0.8, 0.8)
        tilt = rng.uniform(1.0, 1.3) if outward[2] > 0.5 else tilt
    toward = np.array([np.cos(around), np.sin(around), np.tan(tilt)]) * np.cos(tilt)
    if kind == "sunsky":
        plugin = {"type": "sunsky", "sun_direction": [float(v) for v in toward]}
        scale = {"sun_scale": 10.0, "sky_scale": 10.0, "turbidity": float(rng.uniform(2.5, 6))}
        return (plugin | scale,), toward, 11.0, 0.9  # measured, elevations of 15 to 60 degrees
    night = kind in ("lamps", "bulbs")
    tint = _white(rng) * (rng.uniform(0.01, 0.1) if night else 1)
    sky: tuple[MitsubaDict, ...] = ({"type": "constant", "radiance": rgb(tint)},)
    dome = float(tint @ BRIGHTNESS)
    if kind != "sun":
        return sky, toward, 0.0, dome
    beam = np.array([1, rng.uniform(0.75, 1), rng.uniform(0.5, 0.95)]) * rng.uniform(5, 14)
    sun = {"type": "directional", "direction": [float(-v) for v in toward]}
    return (*sky, sun | {"irradiance": rgb(beam)}), toward, float(beam @ BRIGHTNESS), dome


def _white(rng: Generator) -> Floats:
    """White, between warm and cool."""
    return np.array([1, 1, 1]) + rng.uniform(-1, 1) * np.array([0.2, 0, -0.3])


def _lamps(rng: Generator, place: Place, scale: float) -> Mesh:
    """A few rectangles of one radiance under the roof, or hanging in the open."""
    spread = np.array(place.half) - 0.7 * place.lamp - 0.1
    lamps = []
    for k in range(int(rng.integers(1, 5) * place.lamp)):
        x, y = rng.uniform(0.5, 1.4, 2) * place.lamp
        down = quads([-x / 2, y / 2, 0], [x, 0, 0], [0, -y, 0])
        slant = rotation_matrix(
            np.eye(3)[rng.integers(2)], 0 if place.roof else rng.uniform(-0.6, 0.6)
        )
        drop = 0.02 + 0.01 * k if place.roof else rng.uniform(0, 1)
        lamps.append(transform(down, [*rng.uniform(-spread, spread), place.top - drop], slant))
    power = rng.uniform(4, 12) * scale / place.lamp**2
    return _emissive("lamps", merge(*lamps), rgb(_white(rng) * power))


def _bulbs(rng: Generator, place: Place) -> Mesh:
    """Many small square lamps, each of its own colour, on walls and roof or around an open place.

    One mesh, one texel of an atlas a lamp; every texel is covered by exactly one lamp, so that a
    sampler of the texture always lands on the mesh.
    """
    cols, rows = int(rng.integers(8, 21)), int(rng.integers(6, 17))
    count = cols * rows
    centres, normals = (_on_walls if place.roof else _around)(rng, place, count)
    sides = rng.uniform(0.05, 0.2, (count, 1)) * (1 if place.size == 1 else 1.6)
    across = np.cross(normals, np.where(np.abs(normals[:, :1]) < 0.7, [[1, 0, 0]], [[0, 1, 0]]))
    across *= sides / np.linalg.norm(across, axis=-1, keepdims=True)
    up = np.cross(normals, across)
    shape = quads(centres - (across + up) / 2, across, up)

    texel = np.stack([np.arange(count) % cols, np.arange(count) // cols], -1)[:, None]
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    shape = shape._replace(uv=((texel + corners) / [cols, rows]).reshape(-1, 2).astype(np.float32))
    hues = np.stack([colour(rng, 0.7, 1, vivid=0.85) for _ in range(int(rng.integers(2, 7)))])
    power = 6 * 2 ** rng.uniform(-1, 1, (count, 1))
    atlas = (hues[rng.integers(len(hues), size=count)] * power).reshape(rows, cols, 3)
    bitmap = {"type": "bitmap", "data": atlas.astype(np.float32), "raw": True}
    return _emissive("bulbs", shape, bitmap | {"filter_type": "nearest", "wrap_mode": "clamp"})


def _on_walls(rng: Generator, place: Place, count: int) -> tuple[Floats, Floats]:
    """Places [n 3] 2 cm before the four walls and the roof, and normals [n 3] into the room."""
    high = np.array([*place.half, place.top])
    spot = rng.uniform([*(0.2 - high[:2]), 0.4], high - 0.2, (count, 3))
    axis, sign = np.array([[0, 0, 1, 1, 2], [1, -1, 1, -1, 1]])[:, rng.integers(5, size=count)]
    lamp = np.arange(count)
    spot[lamp, axis] = sign * (high[axis] - 0.02)
    normals = np.zeros((count, 3))
    normals[lamp, axis] = -sign
    return spot, normals


def _around(rng: Generator, place: Place, count: int) -> tuple[Floats, Floats]:
    """Places [n 3] in a ring about an open place, and normals [n 3] towards its middle."""
    angle, far = rng.uniform(0, 2 * np.pi, count), rng.uniform(5.6, 8, count)
    spot = np.stack([far * np.cos(angle), far * np.sin(angle), rng.uniform(0.5, 4, count)], -1)
    inward = rng.uniform([-2, -2, 0], [2, 2, 1], (count, 3)) - spot
    return spot, inward / np.linalg.norm(inward, axis=-1, keepdims=True)


def _emissive(name: str, shape: Shape, radiance: MitsubaDict) -> Mesh:
    black: MitsubaDict = {"type": "diffuse", "reflectance": rgb(np.full(3, 0.1))}
    emission = {"type": "area", "radiance": radiance}
    return Mesh(name, shape.vertices, shape.faces, black, shape.uv, emission)


def _flux(lamp: Mesh) -> float:
    """Flux that leaves a lamp, as mean luminance x area x pi."""
    p, q, r = (lamp.vertices[lamp.faces[:, k]].astype(float) for k in range(3))
    area = np.linalg.norm(np.cross(q - p, r - p), axis=-1) / 2
    assert lamp.emission is not None
    radiance = lamp.emission["radiance"]
    values = np.asarray(radiance.get("data", radiance.get("value")), float).reshape(-1, 3)
    each = np.resize(np.repeat(values, 2, 0), (len(area), 3))  # two triangles a texel
    return float(np.pi * area @ each @ BRIGHTNESS)


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
