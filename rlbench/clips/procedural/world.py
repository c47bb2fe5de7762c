"""A small animated world in closed form: its numbers, from a seed, and where all is at any time.

Three spinning, wandering spheres on a square floor before a wall, under a sky; the camera drifts
and turns. Lengths are metres, z is up, the camera looks along +y.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

SPHERES = 3
OBJECTS = SPHERES + 2  # spheres, floor, wall


@dataclass(frozen=True)
class World:
    """The numbers that make one world an individual; n worlds side by side."""

    centre: Float[Tensor, "n k 3"]  # of the spheres' paths, metres
    swing: Float[Tensor, "n k 3"]  # amplitude of the paths, metres
    phase: Float[Tensor, "n k"]  # radians
    radius: Float[Tensor, "n k"]  # metres
    spin: Float[Tensor, "n o"]  # about the vertical axis, radians per frame; floor and wall 0
    colour: Float[Tensor, "n o 2 3"]  # the two albedos of each object
    gain: Float[Tensor, "n o"]  # of the light that each object receives; one sphere is bright
    camera: Float[Tensor, " n"]  # phase of its path, radians


def random_world(seeds: list[str], device: torch.device) -> World:
    """One world for each seed."""
    rolls = [random.Random(seed) for seed in seeds]

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        values = [[roll.uniform(low, high) for _ in range(math.prod(shape))] for roll in rolls]
        return torch.tensor(values, dtype=torch.float64, device=device).reshape(-1, *shape)

    radius = uniform(0.5, 0.8, SPHERES)
    slots = torch.tensor([-1.7, 0.0, 1.7], dtype=torch.float64, device=device)
    place = torch.stack((slots.expand_as(radius), torch.zeros_like(radius), radius + 0.15), -1)
    rise = torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64, device=device)
    still = torch.tensor([1.0] * SPHERES + [0.0, 0.0], dtype=torch.float64, device=device)
    gain = uniform(0.8, 1.2, OBJECTS)
    gain[:, 0] *= 5
    return World(
        centre=place + uniform(-0.25, 0.25, SPHERES, 3) * rise,
        swing=uniform(0.2, 0.5, SPHERES, 3) * (rise + 0.25),
        phase=uniform(0, 2 * math.pi, SPHERES),
        radius=radius,
        spin=uniform(-0.06, 0.06, OBJECTS) * still,
        colour=uniform(0.05, 0.95, OBJECTS, 2, 3),
        gain=gain,
        camera=uniform(0, 2 * math.pi),
    )


def centres(world: World, time: float) -> Float[Tensor, "n o 3"]:
    """Where each object's own origin is; floor and wall stay at the world's."""
    turn = world.phase[..., None] + 0.2 * time * torch.tensor([1.0, 0.8, 1.3]).to(world.phase)
    lift = torch.tensor([0.0, 0.0, 1.0]).to(world.phase)
    moved = world.centre + world.swing * (turn.sin() + lift)  # never below the floor
    return torch.cat((moved, moved.new_zeros(moved.shape[0], 2, 3)), 1)


def pose(world: World, time: float) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3 3"]]:
    """The camera's origin, and its axes as rows: right, down, forward."""
    turn = world.camera + 0.12 * time
    origin = torch.stack((0.9 * turn.sin(), -5 + 0.6 * (0.7 * turn).cos(), 1.6 + 0 * turn), -1)
    yaw, pitch = 0.18 * (0.9 * turn).cos(), 0.12
    c, s, zero = yaw.cos(), yaw.sin(), torch.zeros_like(yaw)
    flat = torch.stack((s, c, zero), -1)  # forward, before tilting down
    up = torch.tensor([0.0, 0.0, 1.0]).to(yaw)
    right = torch.stack((c, -s, zero), -1)
    forward = math.cos(pitch) * flat - math.sin(pitch) * up
    return origin, torch.stack((right, -math.sin(pitch) * flat - math.cos(pitch) * up, forward), 1)
