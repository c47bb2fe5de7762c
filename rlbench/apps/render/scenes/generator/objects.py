"""Random objects on the floor: solids, tables, bundles of rods, glass and leafy bushes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from rlbench.apps.render.scenes.generator.motion import CameraTrack, footprint_radius, is_blocked
from rlbench.apps.render.scenes.generator.places import Disc, Place
from rlbench.apps.render.scenes.generator.solids import (
    SOLIDS,
    build_ball,
    build_box,
    build_crate,
    build_foliage,
    build_torus,
    build_vase,
)
from rlbench.apps.render.scenes.parts.shapes import (
    Float64Array,
    Shape,
    boxes,
    cylinder,
    merge,
    transform,
    yaw_matrix,
)


def scatter_objects(
    rng: Generator,
    place: Place,
    track: CameraTrack,
    occupied: Sequence[Disc],
    without_glass: bool,
) -> dict[str, Shape]:
    """Objects on the floor, clear of the camera, of occupied discs and of each other.

    Objects with the same material are merged; keys are names of materials. Leaves of the place join
    those of the bushes.
    """
    discs = list(occupied)
    shapes: dict[str, list[Shape]] = {}
    bounds = np.array(place.half_size)
    requested = int(rng.integers(10, 24) * place.object_scale)
    for _ in range(4 * requested):
        name, item = draw_object(rng, place.object_scale)
        if name == "glass" and without_glass:
            continue
        radius = footprint_radius(item)
        spot = _draw_spot(rng, bounds, radius, track.focus)
        if is_blocked(spot, radius, discs, track, place.camera_clearance):
            continue
        discs.append((float(spot[0]), float(spot[1]), radius))
        shapes.setdefault(name, []).append(transform(item, [*spot, place.floor_height + 0.003]))
        if sum(map(len, shapes.values())) == requested:
            break
    if "leaf" in place.shell:
        shapes.setdefault("leaf", []).append(place.shell["leaf"])
    return {name: merge(*items) for name, items in shapes.items()}


def draw_object(rng: Generator, size: float) -> tuple[str, Shape]:
    """The name of a material, and a random object of it that stands on the origin."""
    names = ("solid0", "solid1", "solid2", "glass", "leaf")
    name = str(rng.choice(names, p=(0.27, 0.25, 0.2, 0.1, 0.18)))
    size *= rng.uniform(0.5, 1.1)
    if name == "leaf":
        radii = size * rng.uniform(0.25, 0.6, 3)
        leaf_count, leaf_size = int(rng.integers(150, 500)), size * rng.uniform(0.08, 0.25)
        bush = build_foliage(rng, leaf_count, radii, leaf_size)
        return name, transform(bush, [0, 0, radii[2] + 0.2 * size])
    glass = (build_ball, build_torus, build_crate, build_vase)
    builders = glass if name == "glass" else (*SOLIDS, _build_rods, _build_table)
    item = builders[rng.integers(len(builders))](rng, size)
    return name, transform(item, [0, 0, 0], yaw_matrix(rng.uniform(0, 2 * np.pi)))


def _draw_spot(
    rng: Generator, bounds: Float64Array, radius: float, focus: Float64Array
) -> Float64Array:
    """A spot [2] for an object: anywhere within the bounds, or near the focus."""
    spot = rng.uniform(-bounds + radius, np.maximum(bounds - radius, radius - bounds + 0.01))
    if rng.random() < 0.5:
        spot = np.clip(focus[:2] + rng.normal(size=2), -bounds + radius, bounds - radius)
    return np.asarray(spot)


def _build_rods(rng: Generator, size: float) -> Shape:
    """Three to thirteen thin bars that lean at random."""
    rods, shear = [], np.eye(3, dtype=np.float32)
    for _ in range(int(rng.integers(3, 14))):
        rod = cylinder(rng.uniform(0.008, 0.03), 0, size * rng.uniform(0.8, 2), sides=6)
        shear[:2, 2] = rng.uniform(-0.2, 0.2, 2)
        rods.append(transform(rod, [*rng.uniform(-0.4, 0.4, 2) * size, 0], shear))
    return merge(*rods)


def _build_table(rng: Generator, size: float) -> Shape:
    """A table on four legs."""
    x, y, z = size * rng.uniform([0.7, 0.5, 0.4], [1.2, 0.9, 0.8])
    feet = 0.45 * np.array([[x, y, 0], [-x, y, 0], [x, -y, 0], [-x, -y, 0]])
    legs = boxes(feet - [0.03, 0.03, 0], feet + [0.03, 0.03, z])
    return merge(legs, transform(build_box(x, y, 0.05), [0, 0, z]))
