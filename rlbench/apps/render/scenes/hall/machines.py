"""Machines that move in the hall: drones, a crane below the ceiling, and two turning rings."""

from __future__ import annotations

import numpy as np

from rlbench.apps.render.scenes.hall.lamps import (
    AMBER,
    CYAN,
    RING_Y,
    RING_Z,
    ROSE,
    WHITE,
    Lamps,
    concatenate_lamps,
    lamp_circle,
    transform_lamps,
)
from rlbench.apps.render.scenes.parts.shapes import (
    Float32Array,
    Float64Array,
    Shape,
    boxes,
    cylinder,
    icosphere,
    lathe,
    merge,
    transform,
    yaw_matrix,
)
from rlbench.apps.render.scenes.parts.shapes import rotation_matrix as about
from rlbench.apps.render.scenes.parts.sheets import torus

DRONES = ((-2.2, 9.0, 2.6), (2.4, 11.0, 3.6), (0.2, 21.0, 2.2), (-3.2, 14.0, 4.4))
RING_CENTRE = np.array([0, RING_Y, RING_Z])  # metres: centre of the rings


def build_machines(time: float) -> Shape:
    """Drones, rings and crane, at a time."""
    hull = merge(
        transform(icosphere(3), (0, 0, 0), scale=0.3),
        lathe([(0.34, -0.05), (0.62, -0.02), (0.62, 0.04), (0.34, 0.08)], 40),
        torus(0.62, 0.05, 40, 8),
        boxes((-0.04, -0.04, 0.2), (0.04, 0.04, 0.62)),
    )
    drones = [transform(hull, *_drone_pose(index, time)) for index in range(len(DRONES))]
    wheels = [
        transform(_build_wheel(radius, teeth), RING_CENTRE, _wheel_rotation(number, time))
        for number, (radius, teeth) in enumerate(((2.15, 24), (1.5, 16)))
    ]
    return merge(*drones, *wheels, _build_crane(time))


def machine_lamps(time: float) -> Lamps:
    """The lamps that the machines carry, at a time."""
    drones = [_drone_lamps(index, time) for index in range(len(DRONES))]
    outer = lamp_circle(36, 2.12, (0.2, 0.12), AMBER)
    inner = lamp_circle(24, 1.46, (0.2, 0.1), CYAN)
    offset = np.array([0, -0.29, 0])
    wheels = [
        transform_lamps(one, RING_CENTRE + offset, _wheel_rotation(k, time))
        for k, one in enumerate((outer, inner))
    ]
    return concatenate_lamps([*drones, *wheels])


def _build_wheel(radius: float, teeth: int) -> Shape:
    """A ring in the plane of x and z, with teeth inside and a tube along its rim."""
    face = about((1, 0, 0), -np.pi / 2)
    band = lathe([(radius, -0.26), (radius + 0.2, -0.28), (radius + 0.2, 0.28), (radius, 0.26)], 64)
    inside = lathe([(radius, -0.26), (radius, 0.26)], 64)
    tooth = boxes((-0.09, -0.2, radius - 0.16), (0.09, 0.2, radius + 0.02))
    turns = [about((0, 1, 0), 2 * np.pi * k / teeth) for k in range(teeth)]
    return merge(
        transform(merge(band, inside), (0, 0, 0), face),
        *(transform(tooth, (0, 0, 0), turn) for turn in turns),
        transform(torus(radius + 0.1, 0.07, 64, 8), (0, 0.26, 0), face),
    )


def _wheel_rotation(number: int, time: float) -> Float32Array:
    return about((0, 1, 0), 2 * np.pi * time / (300.0, -190.0)[number])


def _build_crane(time: float) -> Shape:
    """A bridge crane below the ceiling, with trolley, rope and grab, at a time."""
    y = 11.5 + 2.0 * np.sin(2 * np.pi * time / 160)
    x = 2.6 + 1.2 * np.sin(2 * np.pi * time / 90 + 1)
    drop = 4.1 + 0.4 * np.sin(2 * np.pi * time / 75)
    bridge = boxes(
        [(-4.6, y - 0.35, 5.65), (-4.6, y + 0.2, 5.65)],
        [(4.6, y - 0.2, 5.95), (4.6, y + 0.35, 5.95)],
    )
    trolley = boxes((x - 0.4, y - 0.45, 5.5), (x + 0.4, y + 0.45, 5.8))
    rope = transform(cylinder(0.025, drop, 5.5, 8), (x, y, 0))
    claw = boxes([(-0.3, -0.06, -0.5), (0.2, -0.06, -0.5)], [(-0.2, 0.06, 0.1), (0.3, 0.06, 0.1)])
    grab = merge(claw, boxes((-0.35, -0.2, 0.0), (0.35, 0.2, 0.22)))
    return merge(bridge, trolley, rope, transform(grab, (x, y, drop), yaw_matrix(time / 40)))


def _drone_pose(index: int, time: float) -> tuple[Float64Array, Float32Array]:
    """Position and rotation of a drone at a time."""
    phase, period = 1.7 * index, 90 + 17 * index
    angle = 2 * np.pi * time / period + phase
    drift = np.array([1.3 * np.sin(angle), 0.9 * np.cos(angle), 0.35 * np.sin(2 * angle)])
    return np.array(DRONES[index]) + drift, yaw_matrix(2 * angle)


def _drone_lamps(index: int, time: float) -> Lamps:
    """Four lamps below a drone that emit downwards."""
    at, turn = _drone_pose(index, time)
    corner = np.array([(x, y, -0.06) for x in (-0.45, 0.33) for y in (-0.06, 0.06)])
    one = np.ones((4, 1))
    colour = (WHITE, CYAN, AMBER, ROSE)[index]
    at_rest = Lamps(corner, one * (0, 0.1, 0), one * (0.12, 0, 0), np.full(4, colour))
    return transform_lamps(at_rest, at, turn)
