"""Ray casting of the procedural world: analytic intersections of rays through pixel centres."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.clips.procedural.world import OBJECTS, SPHERES, World, camera_pose, object_centres

FLOOR = 5.0  # half the side of the floor, metres
WALL = 3.0  # height of the wall at y = FLOOR, metres
FOV = math.radians(60.0)  # horizontal
LIGHT = (-0.48, -0.6, 0.64)  # unit vector towards the light
BEHIND_OFFSET = 4.0  # image sizes that motion points away where a point was behind the camera


class CameraBuffers(NamedTuple):
    """Buffers of a camera, float64. In the sky, depth is +inf, and albedo and normal are 0."""

    albedo: Float[Tensor, "n 3 h w"]
    normal: Float[Tensor, "n 3 h w"]
    depth: Float[Tensor, "n 1 h w"]
    motion: Float[Tensor, "n 2 h w"]
    radiance: Float[Tensor, "n 3 h w"]
    shade: Float[Tensor, "n 1 h w"]  # 0 in full light and in the sky, 1 facing away from the light


def raycast(world: World, time: float, before: float, h: int, w: int) -> CameraBuffers:
    """Buffers of the world at `time`, with motion back to the time `before`, both in frames."""
    origin, axes = camera_pose(world, time)
    focal = w / 2 / math.tan(FOV / 2)  # pixels
    x = torch.arange(w).to(origin) + 0.5
    y = torch.arange(h).to(origin)[:, None] + 0.5
    pixels = torch.stack((x.expand(h, w), y.expand(h, w)))
    offset = (pixels - pixels.new_tensor([w / 2, h / 2])[:, None, None]) / focal
    plane = torch.cat((offset, torch.ones_like(offset[:1])))
    ray = torch.einsum("nkc,khw->nchw", axes, plane)  # advances 1 along the view axis
    centres = object_centres(world, time)
    distances = _distances(world, centres, origin, ray)
    depth, hit = distances.min(1, keepdim=True)  # n 1 h w
    sky = depth.isinf()

    # visible point, in the world and relative to the centre of its object
    distance = depth.where(~sky, 1.0)  # in the sky, `point` is a direction
    point = origin[..., None, None] * ~sky + distance * ray
    local = point - _per_pixel(centres, hit) * ~sky
    normal = _normals(world, local, hit) * ~sky
    unrotated = _rotate(local, -time * _per_pixel(world.spin[..., None], hit))
    albedo = _texture(world, unrotated, hit) * ~sky
    lambert = (1 + torch.einsum("nchw,c->nhw", normal, origin.new_tensor(LIGHT))[:, None]) / 2
    light = 0.15 + 1.6 * lambert.square()
    light = light * _visibility(world, centres, point, normal, hit)
    light = light * _per_pixel(world.gain[..., None], hit)

    # position of that point at the time `before`
    previous_local = _rotate(local, (before - time) * _per_pixel(world.spin[..., None], hit) * ~sky)
    previous = previous_local + _per_pixel(object_centres(world, before), hit) * ~sky
    motion = _project(world, previous, sky, before, focal, pixels) - pixels
    radiance = torch.where(sky, _sky(ray), albedo * light)
    return CameraBuffers(albedo, normal, depth, motion, radiance, (1 - lambert.square()) * ~sky)


def _distances(world: World, centres: Tensor, origin: Tensor, ray: Tensor) -> Tensor:
    """[n o h w] Distance along the view axis to each object, +inf where the ray misses it."""
    from_centre = origin[:, None] - centres[:, :SPHERES]  # n k 3
    a = ray.square().sum(1, keepdim=True)
    b = torch.einsum("nkc,nchw->nkhw", from_centre, ray)
    c = (from_centre.square().sum(-1) - world.radius.square())[..., None, None]
    discriminant = b.square() - a * c
    spheres = (-b - discriminant.clamp_min(0).sqrt()) / a
    spheres = spheres.where((discriminant > 0) & (spheres > 0), torch.inf)

    ox, oy, oz = origin[..., None, None].unbind(1)
    dx, dy, dz = ray.unbind(1)
    floor = -oz / dz.where(dz < 0, -1e-12)
    on_floor = (dz < 0) & ((ox + floor * dx).abs() < FLOOR) & ((oy + floor * dy).abs() < FLOOR)
    wall = (FLOOR - oy) / dy.where(dy > 0, 1e-12)
    height = oz + wall * dz
    on_wall = (dy > 0) & ((ox + wall * dx).abs() < FLOOR) & (height > 0) & (height < WALL)
    planes = torch.stack((floor.where(on_floor, torch.inf), wall.where(on_wall, torch.inf)), 1)
    return torch.cat((spheres, planes), 1)


def _per_pixel(values: Tensor, hit: Tensor) -> Tensor:
    """[n c h w] The value [n o c] of the object that each pixel hits."""
    n, _, h, w = hit.shape
    gathered = values.gather(1, hit.reshape(n, -1, 1).expand(-1, -1, values.shape[-1]))
    return gathered.transpose(1, 2).reshape(n, -1, h, w)


def _normals(world: World, local: Tensor, hit: Tensor) -> Tensor:
    """[n 3 h w] World-space unit normals of the objects that pixels hit."""
    plane_normals = local.new_tensor([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    on_plane = plane_normals[(hit - SPHERES).clamp_min(0)[:, 0]].permute(0, 3, 1, 2)
    radius = F.pad(world.radius, (0, OBJECTS - SPHERES), value=1.0)[..., None]
    return torch.where(hit < SPHERES, local / _per_pixel(radius, hit), on_plane)


def _rotate(local: Tensor, angle: Tensor) -> Tensor:
    """[n 3 h w] Rotate about the vertical axis by `angle` [n 1 h w], radians."""
    x, y, z = local.chunk(3, 1)
    c, s = angle.cos(), angle.sin()
    return torch.cat((c * x - s * y, s * x + c * y, z), 1)


def _texture(world: World, local: Tensor, hit: Tensor) -> Tensor:
    """[n 3 h w] Albedo: a smooth pattern of two colours, fixed to the object."""
    x, y, z = local.chunk(3, 1)
    wave = (4 * x + 0.5).sin() + (4 * y + 1.0).sin() + (4 * z + 1.5).sin()
    weight = torch.sigmoid(2 * wave)
    first, second = (_per_pixel(world.colour[:, :, i], hit) for i in range(2))
    return weight * first + (1 - weight) * second


def _visibility(
    world: World, centres: Tensor, point: Tensor, normal: Tensor, hit: Tensor
) -> Tensor:
    """[n 1 h w] Light on floor and wall that the spheres do not block: 1 - cos r^2 / d^2 each."""
    visible = torch.ones_like(point[:, :1])
    for k in range(SPHERES):
        towards = centres[:, k, :, None, None] - point
        square = towards.square().sum(1, keepdim=True)
        cos = (normal * towards).sum(1, keepdim=True).clamp_min(0) / square.sqrt()
        visible = visible * (1 - (cos * world.radius[:, k, None, None, None].square() / square))
    return visible.where(hit >= SPHERES, 1.0)


def _project(
    world: World, point: Tensor, sky: Tensor, time: float, focal: float, pixels: Tensor
) -> Tensor:
    """[n 2 h w] Image position, pixels, of a point or, in the sky, of a direction at `time`."""
    h, w = pixels.shape[-2:]
    origin, axes = camera_pose(world, time)
    right, down, forward = torch.einsum(
        "nkc,nchw->nkhw", axes, point - origin[..., None, None] * ~sky
    ).chunk(3, 1)
    ahead = forward > 1e-3
    scale = focal / forward.where(ahead, 1.0)
    size = pixels.new_tensor([w, h])[:, None, None]
    position = torch.cat((right, down), 1) * scale + size / 2
    return position.where(ahead, pixels + BEHIND_OFFSET * size)


def _sky(ray: Tensor) -> Tensor:
    """[n 3 h w] Radiance of the sky, brighter towards the zenith."""
    tint = ray.new_tensor([0.5, 0.7, 1.0])[:, None, None]
    elevation = ray[:, 2:] / ray.square().sum(1, keepdim=True).sqrt()
    return torch.mul(0.6 + 0.6 * elevation, tint)
