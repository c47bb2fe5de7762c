"""What the camera of the closed-form world sees: rays through pixel centres, met by formula."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.clips.procedural.world import OBJECTS, SPHERES, World, centres, pose

FLOOR = 5.0  # half its side, metres
WALL = 3.0  # its height, metres; it stands at y = FLOOR
FOV = math.radians(60.0)  # horizontal
LIGHT = (-0.48, -0.6, 0.64)  # unit vector towards the light
AWAY = 4.0  # image sizes to which motion points where the previous camera had the point behind it


class CameraBuffers(NamedTuple):
    """What the camera sees at one moment, float64; zero and +inf depth where it sees the sky."""

    albedo: Float[Tensor, "n 3 h w"]
    normal: Float[Tensor, "n 3 h w"]
    depth: Float[Tensor, "n 1 h w"]
    motion: Float[Tensor, "n 2 h w"]
    radiance: Float[Tensor, "n 3 h w"]
    shade: Float[Tensor, "n 1 h w"]  # 0 in full light and in the sky, 1 turned away from the light


def raycast(world: World, time: float, before: float, h: int, w: int) -> CameraBuffers:
    """The world at `time`, with motion from there back to the moment `before`."""
    origin, axes = pose(world, time)
    focal = w / 2 / math.tan(FOV / 2)  # pixels
    x = torch.arange(w).to(origin) + 0.5
    y = torch.arange(h).to(origin)[:, None] + 0.5
    here = torch.stack((x.expand(h, w), y.expand(h, w)))
    flat = (here - here.new_tensor([w / 2, h / 2])[:, None, None]) / focal
    plane = torch.cat((flat, torch.ones_like(flat[:1])))
    ray = torch.einsum("nkc,khw->nchw", axes, plane)  # advances 1 along the view axis
    there = centres(world, time)
    distances = _distances(world, there, origin, ray)
    depth, hit = distances.min(1, keepdim=True)  # n 1 h w
    sky = depth.isinf()

    # the point that is seen, in the world and from its object's origin
    reach = depth.where(~sky, 1.0)  # in the sky a direction stands for the point
    point = origin[..., None, None] * ~sky + reach * ray
    local = point - _of(there, hit) * ~sky
    normal = _normals(world, local, hit) * ~sky
    turned = _spun(local, -time * _of(world.spin[..., None], hit))
    albedo = _texture(world, turned, hit) * ~sky
    lambert = (1 + torch.einsum("nchw,c->nhw", normal, origin.new_tensor(LIGHT))[:, None]) / 2
    light = 0.15 + 1.6 * lambert.square()
    light = light * _open(world, there, point, normal, hit) * _of(world.gain[..., None], hit)

    # where that point was
    back = _spun(local, (before - time) * _of(world.spin[..., None], hit) * ~sky)
    past = back + _of(centres(world, before), hit) * ~sky
    motion = _project(world, past, sky, before, focal, here) - here
    radiance = torch.where(sky, _sky(ray), albedo * light)
    return CameraBuffers(albedo, normal, depth, motion, radiance, (1 - lambert.square()) * ~sky)


def _distances(world: World, there: Tensor, origin: Tensor, ray: Tensor) -> Tensor:
    """[n o h w] Distance along the view axis to each object, +inf where the ray misses it."""
    inside = origin[:, None] - there[:, :SPHERES]  # n k 3
    a = ray.square().sum(1, keepdim=True)
    b = torch.einsum("nkc,nchw->nkhw", inside, ray)
    c = (inside.square().sum(-1) - world.radius.square())[..., None, None]
    root = b.square() - a * c
    balls = (-b - root.clamp_min(0).sqrt()) / a
    balls = balls.where((root > 0) & (balls > 0), torch.inf)

    ox, oy, oz = origin[..., None, None].unbind(1)
    dx, dy, dz = ray.unbind(1)
    floor = -oz / dz.where(dz < 0, -1e-12)
    on_floor = (dz < 0) & ((ox + floor * dx).abs() < FLOOR) & ((oy + floor * dy).abs() < FLOOR)
    wall = (FLOOR - oy) / dy.where(dy > 0, 1e-12)
    height = oz + wall * dz
    on_wall = (dy > 0) & ((ox + wall * dx).abs() < FLOOR) & (height > 0) & (height < WALL)
    flats = torch.stack((floor.where(on_floor, torch.inf), wall.where(on_wall, torch.inf)), 1)
    return torch.cat((balls, flats), 1)


def _of(values: Tensor, hit: Tensor) -> Tensor:
    """[n c h w] The value [n o c] of the object that each pixel hits."""
    n, _, h, w = hit.shape
    chosen = values.gather(1, hit.reshape(n, -1, 1).expand(-1, -1, values.shape[-1]))
    return chosen.transpose(1, 2).reshape(n, -1, h, w)


def _normals(world: World, local: Tensor, hit: Tensor) -> Tensor:
    flats = local.new_tensor([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    flat = flats[(hit - SPHERES).clamp_min(0)[:, 0]].permute(0, 3, 1, 2)
    radius = F.pad(world.radius, (0, OBJECTS - SPHERES), value=1.0)[..., None]
    return torch.where(hit < SPHERES, local / _of(radius, hit), flat)


def _spun(local: Tensor, angle: Tensor) -> Tensor:
    """Turned about the vertical axis by `angle` [n 1 h w]."""
    x, y, z = local.chunk(3, 1)
    c, s = angle.cos(), angle.sin()
    return torch.cat((c * x - s * y, s * x + c * y, z), 1)


def _texture(world: World, local: Tensor, hit: Tensor) -> Tensor:
    """A smooth pattern of two colours, fixed to the object."""
    x, y, z = local.chunk(3, 1)
    wave = (4 * x + 0.5).sin() + (4 * y + 1.0).sin() + (4 * z + 1.5).sin()
    share = torch.sigmoid(2 * wave)
    one, two = (_of(world.colour[:, :, i], hit) for i in range(2))
    return share * one + (1 - share) * two


def _open(world: World, there: Tensor, point: Tensor, normal: Tensor, hit: Tensor) -> Tensor:
    """Share of the light on floor and wall that the spheres leave: 1 - cos r^2 / d^2 for each."""
    left = torch.ones_like(point[:, :1])
    for k in range(SPHERES):
        towards = there[:, k, :, None, None] - point
        square = towards.square().sum(1, keepdim=True)
        cos = (normal * towards).sum(1, keepdim=True).clamp_min(0) / square.sqrt()
        left = left * (1 - (cos * world.radius[:, k, None, None, None].square() / square))
    return left.where(hit >= SPHERES, 1.0)


def _project(
    world: World, past: Tensor, sky: Tensor, before: float, focal: float, here: Tensor
) -> Tensor:
    """[n 2 h w] Position in the image, pixels, of a point or, in the sky, of a direction."""
    h, w = here.shape[-2:]
    origin, axes = pose(world, before)
    right, down, forward = torch.einsum(
        "nkc,nchw->nkhw", axes, past - origin[..., None, None] * ~sky
    ).chunk(3, 1)
    ahead = forward > 1e-3
    scale = focal / forward.where(ahead, 1.0)
    size = here.new_tensor([w, h])[:, None, None]
    seen = torch.cat((right, down), 1) * scale + size / 2
    return seen.where(ahead, here + AWAY * size)


def _sky(ray: Tensor) -> Tensor:
    tint = ray.new_tensor([0.5, 0.7, 1.0])[:, None, None]
    rise = ray[:, 2:] / ray.square().sum(1, keepdim=True).sqrt()
    return torch.mul(0.6 + 0.6 * rise, tint)
