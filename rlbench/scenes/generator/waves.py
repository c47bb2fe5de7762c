"""Plane waves that deform water, leaves and cloth over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.random import Generator

from rlbench.scenes.parts.shape import Float32Array, Float64Array, Shape

VertexMotion = Callable[[float], Float32Array]  # from time in frames to vertices [v 3]


def draw_waving_parts(rng: Generator, parts: Mapping[str, Shape]) -> dict[str, VertexMotion]:
    """Motion of the deforming parts: water ripples, and leaves sway in every second scene."""
    motions: dict[str, VertexMotion] = {}
    if "leaf" in parts and rng.random() < 0.5:
        gusts = draw_waves(rng, 3, 2.0, rng.uniform(0.03, 0.12))
        motions["leaf"] = _displace(parts["leaf"], gusts, (1.0, -0.6, 0.3))
    if "water" in parts:
        swell = draw_waves(rng, 6, 1.0, rng.uniform(0.01, 0.05))
        motions["water"] = _displace(parts["water"], swell, (0.0, 0.0, 1.0))
    return motions


def draw_waves(rng: Generator, count: int, length: float, height: float) -> Float64Array:
    """Random plane waves [count 5]: wave vector x y (rad/m), height (m), rad per frame, phase.

    Wavelengths spread by a factor of two about `length`, in metres; crests travel 1 to 4 % of a
    wavelength per frame. The heights sum to `height`, in metres.
    """
    angle, phase = rng.uniform(0, 2 * np.pi, (2, count))
    wavenumber = 2 * np.pi / (length * 2 ** rng.uniform(-1, 1, count))
    speed = 2 * np.pi * rng.uniform(0.01, 0.04, count)
    heights = height / wavenumber / (1 / wavenumber).sum()
    return np.stack(
        [wavenumber * np.cos(angle), wavenumber * np.sin(angle), heights, speed, phase], -1
    )


def wave_height(waves: Float64Array, plane: Float32Array, time: float) -> Float32Array:
    """Height of the waves, in metres, over each point [v 2]; at most the sum of their heights."""
    angle = plane @ waves[:, :2].T + waves[:, 3] * time + waves[:, 4]
    return np.asarray(np.sin(angle) @ waves[:, 2], np.float32)


def _displace(
    part: Shape, waves: Float64Array, direction: tuple[float, float, float]
) -> VertexMotion:
    """Motion that shifts each vertex along `direction` by the height of the waves over it."""
    shift = np.array(direction, np.float32)
    return lambda time: (
        part.vertices + wave_height(waves, part.vertices[:, :2], time)[:, None] * shift
    )
