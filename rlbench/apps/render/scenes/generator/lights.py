"""Random lighting: sky, sun, lamps and coloured bulbs, with an estimate of their mean radiance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from rlbench.apps.render.scene import Mesh, MitsubaDict
from rlbench.apps.render.scenes.generator.materials import random_colour, rgb_texture
from rlbench.apps.render.scenes.generator.places import Place
from rlbench.apps.render.scenes.parts.shapes import (
    Float64Array,
    Shape,
    merge,
    quads,
    rotation_matrix,
    transform,
)

REC709_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # as in rlbench.ops.color, without torch
MEAN_ALBEDO = 0.45  # assumed by the estimate of the mean radiance
LIGHT_KINDS = ("lamps", "bulbs", "sky", "sun", "sunsky")


@dataclass(frozen=True)
class Lighting:
    """Lamps and sky, and an estimate of the mean radiance of the place under them."""

    mean_radiance: float
    sky: tuple[MitsubaDict, ...] = ()
    lamps: tuple[Mesh, ...] = ()
    has_small_sources: bool = False  # mirrors and glass would turn them into fireflies


def draw_lighting(rng: Generator, place: Place, light_kind: str) -> Lighting:
    """Random sky and lamps of one of LIGHT_KINDS, and the mean radiance that they cause.

    The estimate assumes a grey place: an integrating sphere under a roof, else open ground.
    """
    sky, to_sun, sun_irradiance, sky_radiance = draw_sky(rng, place, light_kind)
    lamps = []
    if light_kind == "bulbs":
        lamps = [_draw_bulbs(rng, place)]
    elif light_kind == "lamps" or (place.has_roof and rng.random() < 0.6):
        lamps = [_draw_lamps(rng, place, 1.0 if light_kind == "lamps" else 0.3)]
    flux = sum(map(emitted_flux, lamps))
    if place.has_roof:
        x, y = 2 * place.half_size[0], 2 * place.half_size[1]
        area = 2 * x * y + 2 * (x + y) * (place.lamp_height - place.floor_height)
        for aperture in place.apertures:
            cosine = max(0.0, float(to_sun @ aperture.outward))
            flux += 0.7 * aperture.area * (np.pi * sky_radiance + sun_irradiance * cosine)
        mean_radiance = flux * MEAN_ALBEDO / (np.pi * area * (1 - MEAN_ALBEDO))
    else:
        sun_radiance = 0.7 * sun_irradiance * to_sun[2] / np.pi
        mean_radiance = MEAN_ALBEDO * (flux / 180 / np.pi + 0.8 * sky_radiance + sun_radiance)
    has_small_sources = light_kind in ("bulbs", "sunsky")
    return Lighting(float(mean_radiance), sky, tuple(lamps), has_small_sources)


def draw_sky(
    rng: Generator, place: Place, light_kind: str
) -> tuple[tuple[MitsubaDict, ...], Float64Array, float, float]:
    """Sky emitters, direction to the sun [3], irradiance by the sun, and radiance of the sky."""
    azimuth, elevation = rng.uniform(0, 2 * np.pi), rng.uniform(0.35, 0.9)
    if place.apertures:  # let the sun shine in
        outward = place.apertures[rng.integers(len(place.apertures))].outward
        azimuth = np.arctan2(outward[1], outward[0]) + rng.uniform(-0.8, 0.8)
        elevation = rng.uniform(1.0, 1.3) if outward[2] > 0.5 else elevation
    to_sun = np.array([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)]) * np.cos(elevation)
    if light_kind == "sunsky":
        plugin = {"type": "sunsky", "sun_direction": [float(v) for v in to_sun]}
        scale = {"sun_scale": 10.0, "sky_scale": 10.0, "turbidity": float(rng.uniform(2.5, 6))}
        return (plugin | scale,), to_sun, 11.0, 0.9  # measured at elevations of 15 to 60 degrees
    night = light_kind in ("lamps", "bulbs")
    tint = draw_white(rng) * (rng.uniform(0.01, 0.1) if night else 1)
    sky: tuple[MitsubaDict, ...] = ({"type": "constant", "radiance": rgb_texture(tint)},)
    sky_radiance = float(tint @ REC709_LUMINANCE)
    if light_kind != "sun":
        return sky, to_sun, 0.0, sky_radiance
    beam = np.array([1, rng.uniform(0.75, 1), rng.uniform(0.5, 0.95)]) * rng.uniform(5, 14)
    sun = {"type": "directional", "direction": [float(-v) for v in to_sun]}
    return (
        (*sky, sun | {"irradiance": rgb_texture(beam)}),
        to_sun,
        float(beam @ REC709_LUMINANCE),
        sky_radiance,
    )


def draw_white(rng: Generator) -> Float64Array:
    """A random white [3] between warm and cool."""
    return np.array([1, 1, 1]) + rng.uniform(-1, 1) * np.array([0.2, 0, -0.3])


def _draw_lamps(rng: Generator, place: Place, scale: float) -> Mesh:
    """A few rectangular lamps of one radiance, under the roof or hanging in the open."""
    spread = np.array(place.half_size) - 0.7 * place.lamp_scale - 0.1
    lamps = []
    for k in range(int(rng.integers(1, 5) * place.lamp_scale)):
        x, y = rng.uniform(0.5, 1.4, 2) * place.lamp_scale
        down = quads([-x / 2, y / 2, 0], [x, 0, 0], [0, -y, 0])
        slant = rotation_matrix(
            np.eye(3)[rng.integers(2)], 0 if place.has_roof else rng.uniform(-0.6, 0.6)
        )
        drop = 0.02 + 0.01 * k if place.has_roof else rng.uniform(0, 1)
        lamps.append(
            transform(down, [*rng.uniform(-spread, spread), place.lamp_height - drop], slant)
        )
    power = rng.uniform(4, 12) * scale / place.lamp_scale**2
    return emissive_mesh("lamps", merge(*lamps), rgb_texture(draw_white(rng) * power))


def _draw_bulbs(rng: Generator, place: Place) -> Mesh:
    """Many small square lamps of individual colours, on walls and roof or around an open place.

    They are one mesh with a texture atlas. Each texel belongs to exactly one lamp, so that sampling
    the texture always yields a point on the mesh.
    """
    columns, rows = int(rng.integers(8, 21)), int(rng.integers(6, 17))
    count = columns * rows
    centres, normals = (_bulbs_on_walls if place.has_roof else _bulbs_around)(rng, place, count)
    sides = rng.uniform(0.05, 0.2, (count, 1)) * (1 if place.object_scale == 1 else 1.6)
    across = np.cross(normals, np.where(np.abs(normals[:, :1]) < 0.7, [[1, 0, 0]], [[0, 1, 0]]))
    across *= sides / np.linalg.norm(across, axis=-1, keepdims=True)
    up = np.cross(normals, across)
    shape = quads(centres - (across + up) / 2, across, up)

    texel = np.stack([np.arange(count) % columns, np.arange(count) // columns], -1)[:, None]
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    shape = shape._replace(
        uv=((texel + corners) / [columns, rows]).reshape(-1, 2).astype(np.float32)
    )
    hues = np.stack(
        [random_colour(rng, 0.7, 1, max_saturation=0.85) for _ in range(int(rng.integers(2, 7)))]
    )
    power = 6 * 2 ** rng.uniform(-1, 1, (count, 1))
    atlas = (hues[rng.integers(len(hues), size=count)] * power).reshape(rows, columns, 3)
    bitmap = {"type": "bitmap", "data": atlas.astype(np.float32), "raw": True}
    return emissive_mesh("bulbs", shape, bitmap | {"filter_type": "nearest", "wrap_mode": "clamp"})


def _bulbs_on_walls(rng: Generator, place: Place, count: int) -> tuple[Float64Array, Float64Array]:
    """Positions [n 3] 2 cm inside the four walls and the roof, and normals [n 3] into the room."""
    upper = np.array([*place.half_size, place.lamp_height])
    positions = rng.uniform([*(0.2 - upper[:2]), 0.4], upper - 0.2, (count, 3))
    axis, sign = np.array([[0, 0, 1, 1, 2], [1, -1, 1, -1, 1]])[:, rng.integers(5, size=count)]
    lamp = np.arange(count)
    positions[lamp, axis] = sign * (upper[axis] - 0.02)
    normals = np.zeros((count, 3))
    normals[lamp, axis] = -sign
    return positions, normals


def _bulbs_around(rng: Generator, place: Place, count: int) -> tuple[Float64Array, Float64Array]:
    """Positions [n 3] in a ring around an open place, and normals [n 3] towards its middle."""
    angle, radius = rng.uniform(0, 2 * np.pi, count), rng.uniform(5.6, 8, count)
    positions = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0.5, 4, count)], -1
    )
    inward = rng.uniform([-2, -2, 0], [2, 2, 1], (count, 3)) - positions
    return positions, inward / np.linalg.norm(inward, axis=-1, keepdims=True)


def emissive_mesh(name: str, shape: Shape, radiance: MitsubaDict) -> Mesh:
    """A dark mesh that emits `radiance` from its front."""
    black: MitsubaDict = {"type": "diffuse", "reflectance": rgb_texture(np.full(3, 0.1))}
    emission = {"type": "area", "radiance": radiance}
    return Mesh(name, shape.vertices, shape.faces, black, shape.uv, emission)


def emitted_flux(lamp: Mesh) -> float:
    """Flux that a lamp emits: mean luminance x area x pi."""
    p, q, r = (lamp.vertices[lamp.faces[:, k]].astype(float) for k in range(3))
    area = np.linalg.norm(np.cross(q - p, r - p), axis=-1) / 2
    assert lamp.emission is not None
    radiance = lamp.emission["radiance"]
    values = np.asarray(radiance.get("data", radiance.get("value")), float).reshape(-1, 3)
    radiances = np.resize(np.repeat(values, 2, 0), (len(area), 3))  # two triangles a texel
    return float(np.pi * area @ radiances @ REC709_LUMINANCE)
