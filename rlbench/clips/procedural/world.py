"""The procedural world: random parameters, and the positions of objects and camera at any time.

Three spinning, moving spheres on a square floor in front of a wall, under a sky; the camera moves
and turns. Lengths are in metres, times in frames, z is up, and the camera looks along +y.
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
    """Parameters of n worlds with k spheres and o objects each."""

    centre: Float[Tensor, "n k 3"]  # centres of the spheres' paths, metres
    swing: Float[Tensor, "n k 3"]  # amplitudes of the paths, metres
    phase: Float[Tensor, "n k"]  # phases of the paths, radians
    radius: Float[Tensor, "n k"]  # metres
    spin: Float[Tensor, "n o"]  # about the vertical axis, radians per frame; 0 for floor and wall
    colour: Float[Tensor, "n o 2 3"]  # the two albedos of each object
    gain: Float[Tensor, "n o"]  # factor on the light on each object; one sphere is bright
    camera: Float[Tensor, " n"]  # phase of the camera's path, radians
    camera_speed: Float[Tensor, " n"]  # factor on the camera's movement; 0 for a still camera


def random_world(seeds: list[str], device: torch.device, camera_speed: float = 1.0) -> World:
    """One random world for each seed; the camera moves `camera_speed` times as fast as usual."""
    generators = [random.Random(seed) for seed in seeds]

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        values = [[g.uniform(low, high) for _ in range(math.prod(shape))] for g in generators]
        return torch.tensor(values, dtype=torch.float64, device=device).reshape(-1, *shape)

    radius = uniform(0.5, 0.8, SPHERES)
    columns = torch.tensor([-1.7, 0.0, 1.7], dtype=torch.float64, device=device)
    centre = torch.stack((columns.expand_as(radius), torch.zeros_like(radius), radius + 0.15), -1)
    horizontal = torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64, device=device)
    is_sphere = torch.tensor([1.0] * SPHERES + [0.0, 0.0], dtype=torch.float64, device=device)
    gain = uniform(0.8, 1.2, OBJECTS)
    gain[:, 0] *= 5
    return World(
        centre=centre + uniform(-0.25, 0.25, SPHERES, 3) * horizontal,
        swing=uniform(0.2, 0.5, SPHERES, 3) * (horizontal + 0.25),
        phase=uniform(0, 2 * math.pi, SPHERES),
        radius=radius,
        spin=uniform(-0.06, 0.06, OBJECTS) * is_sphere,
        colour=uniform(0.05, 0.95, OBJECTS, 2, 3),
        gain=gain,
        camera=uniform(0, 2 * math.pi),
        camera_speed=torch.full_like(gain[:, 0], camera_speed),
    )


def object_centres(world: World, time: float) -> Float[Tensor, "n o 3"]:
    """The origins of the objects, metres; those of floor and wall are the world's."""
    angle = world.phase[..., None] + 0.2 * time * torch.tensor([1.0, 0.8, 1.3]).to(world.phase)
    up = torch.tensor([0.0, 0.0, 1.0]).to(world.phase)
    spheres = world.centre + world.swing * (angle.sin() + up)  # never below the floor
    return torch.cat((spheres, spheres.new_zeros(spheres.shape[0], 2, 3)), 1)


def camera_pose(world: World, time: float) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3 3"]]:
    """The origin of the camera, metres, and its axes right, down and forward as rows."""
    phase = world.camera + 0.12 * world.camera_speed * time
    origin = torch.stack((0.9 * phase.sin(), -5 + 0.6 * (0.7 * phase).cos(), 1.6 + 0 * phase), -1)
    yaw, pitch = 0.18 * (0.9 * phase).cos(), 0.12
    c, s, zero = yaw.cos(), yaw.sin(), torch.zeros_like(yaw)
    level = torch.stack((s, c, zero), -1)  # forward without pitch
    up = torch.tensor([0.0, 0.0, 1.0]).to(yaw)
    right = torch.stack((c, -s, zero), -1)
    forward = math.cos(pitch) * level - math.sin(pitch) * up
    return origin, torch.stack((right, -math.sin(pitch) * level - math.cos(pitch) * up, forward), 1)
