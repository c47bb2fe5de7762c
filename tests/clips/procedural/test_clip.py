"""Procedural clips agree with an independent ray caster and point tracker, and are unbiased."""

from __future__ import annotations

import math
from dataclasses import fields
from functools import cache

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from rlbench.clips.procedural import world
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Size
from rlbench.ops.reprojection import reproject

SMALL = Size(1, 12, 16)
SEEDS = (0, 1, 2)


def tensors(frame: Frame) -> dict[str, torch.Tensor]:
    reference = {"a": frame.reference.half_a, "b": frame.reference.half_b}
    return {**frame.gbuffer.buffers, **reference, "pool": frame.pool.radiance}


# A slow, obvious ray caster: one pixel and one object at a time, in plain numbers


def camera(numbers: dict[str, np.ndarray], time: float):
    """Origin, and right, down and forward as cross products of a look direction."""
    turn = numbers["camera"] + 0.12 * time
    origin = np.array([0.9 * math.sin(turn), -5 + 0.6 * math.cos(0.7 * turn), 1.6])
    yaw = 0.18 * math.cos(0.9 * turn)
    forward = np.array(
        [math.sin(yaw) * math.cos(0.12), math.cos(yaw) * math.cos(0.12), -math.sin(0.12)]
    )
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    return origin, right, np.cross(forward, right), forward


def centre(numbers: dict[str, np.ndarray], ball: int, time: float) -> np.ndarray:
    wave = [math.sin(numbers["phase"][ball] + 0.2 * time * rate) for rate in (1.0, 0.8, 1.3)]
    return numbers["centre"][ball] + numbers["swing"][ball] * (np.array(wave) + [0, 0, 1])


def cast(numbers: dict[str, np.ndarray], time: float, x: int, y: int, h: int, w: int):
    """(depth along the axis, object or -1, point, normal) at the centre of a pixel."""
    origin, right, down, forward = camera(numbers, time)
    focal = (w / 2) / math.tan(math.radians(30))
    ray = forward + right * (x + 0.5 - w / 2) / focal + down * (y + 0.5 - h / 2) / focal
    nearest = (math.inf, -1, None, np.zeros(3))
    for ball in range(3):
        middle, radius = centre(numbers, ball, time), numbers["radius"][ball]
        arm = origin - middle
        roots = np.roots([ray @ ray, 2 * ray @ arm, arm @ arm - radius**2])
        near = roots.real.min()
        if abs(roots.imag).max() == 0 and 0 < near < nearest[0]:
            point = origin + near * ray
            nearest = (near, ball, point, (point - middle) / radius)
    if ray[2] < 0 and (t := -origin[2] / ray[2]) < nearest[0]:
        point = origin + t * ray
        if max(abs(point[:2])) < 5:
            nearest = (t, 3, point, np.array([0.0, 0.0, 1.0]))
    if ray[1] > 0 and (t := (5 - origin[1]) / ray[1]) < nearest[0]:
        point = origin + t * ray
        if abs(point[0]) < 5 and 0 < point[2] < 3:
            nearest = (t, 4, point, np.array([0.0, -1.0, 0.0]))
    return nearest


def numbers_of(seed: int) -> dict[str, np.ndarray]:
    random_world = world.random_world([f"{seed}/0"], torch.device("cpu"))
    return {f.name: getattr(random_world, f.name)[0].numpy() for f in fields(random_world)}


@cache
def every_pixel(seed: int, time: float):
    """The slow ray caster for all pixels of a small image, in rows."""
    numbers = numbers_of(seed)
    _, h, w = SMALL
    return [[cast(numbers, time, x, y, h, w) for x in range(w)] for y in range(h)]


@pytest.mark.parametrize("seed", SEEDS)
def test_depth_and_normals_are_those_of_a_slow_ray_caster(seed):
    gbuffer = procedural_clip(seed, SMALL).frames[3].gbuffer
    depth = torch.tensor([[float(p[0]) for p in row] for row in every_pixel(seed, 3.0)])
    assert_close(gbuffer.depth[0, 0], depth, atol=0, rtol=1e-5)  # float32 keeps 7 digits
    normal = torch.tensor(np.array([[p[3] for p in row] for row in every_pixel(seed, 3.0)]))
    assert_close(gbuffer.normal[0].permute(1, 2, 0), normal.float(), atol=1e-5, rtol=0)


def track(numbers: dict[str, np.ndarray], hit, time: float, before: float, h: int, w: int):
    """Image position of the visible point at `before`: moved with its object, then projected."""
    _, obj, point, _ = hit
    if obj < 3:  # undo the rotation and movement of the sphere
        angle = (before - time) * numbers["spin"][obj]
        arm = point - centre(numbers, obj, time)
        cos, sin = math.cos(angle), math.sin(angle)
        turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        point = centre(numbers, obj, before) + turn @ arm
    origin, right, down, forward = camera(numbers, before)
    focal = (w / 2) / math.tan(math.radians(30))
    arm = point - origin
    centred = np.array([right @ arm, down @ arm]) / (forward @ arm) * focal
    return centred + [w / 2 - 0.5, h / 2 - 0.5]


@pytest.mark.parametrize("seed", SEEDS)
def test_motion_points_to_the_previous_position(seed):
    _, h, w = SMALL
    numbers = numbers_of(seed)
    motion = procedural_clip(seed, SMALL).frames[3].gbuffer.motion[0].numpy()
    hits = every_pixel(seed, 3.0)
    pixels = [(x, y) for y in range(h) for x in range(w) if hits[y][x][1] >= 0]
    tracked = np.array([track(numbers, hits[y][x], 3.0, 2.0, h, w) - (x, y) for x, y in pixels])
    assert len(pixels) > 50
    # pixels; motion is float32
    np.testing.assert_allclose([motion[:, y, x] for x, y in pixels], tracked, atol=1e-5)


def test_the_sky_moves_as_the_camera_turns():
    """A direction at infinity, projected by the previous camera with a rotation matrix."""
    _, h, w = size = Size(1, 24, 32)
    frame = procedural_clip(0, size).frames[3]
    y, x = np.argwhere(frame.gbuffer.depth[0, 0].isinf().numpy())[0]
    focal = (w / 2) / math.tan(math.radians(30))
    now, then = (np.stack(camera(numbers_of(0), t)[1:]) for t in (3.0, 2.0))
    ray = np.array([(x + 0.5 - w / 2) / focal, (y + 0.5 - h / 2) / focal, 1.0])
    right, down, forward = then @ now.T @ ray
    position = np.array([right, down]) / forward * focal + [w / 2 - 0.5, h / 2 - 0.5]
    motion = frame.gbuffer.motion[0, :, y, x].numpy()
    np.testing.assert_allclose(motion, position - (x, y), atol=1e-5)


@pytest.mark.parametrize("seed", SEEDS)
def test_albedo_moved_by_motion_is_the_albedo(seed):
    """Textures are fixed to their surfaces; only edges and disoccluded pixels differ."""
    before, now = procedural_clip(seed, Size(1, 192, 256)).frames[3:5]
    moved, valid = reproject(before.gbuffer.albedo, now.gbuffer.motion)
    error = (moved - now.gbuffer.albedo).abs().amax(1, keepdim=True)[valid]
    unmoved = (before.gbuffer.albedo - now.gbuffer.albedo).abs().amax(1, keepdim=True)[valid]
    assert error.median() < 2e-3  # bilinear taps on a smooth texture
    assert (error > 0.02).float().mean() < 0.04  # silhouettes and disoccluded pixels
    assert (error > 0.02).float().mean() < 0.25 * (unmoved > 0.02).float().mean()


# Reference and samples


def test_both_halves_are_without_noise_and_on_a_surface_albedo_times_one_light():
    """Radiance divided by albedo is grey, because the light has no colour."""
    frame = procedural_clip(1, SMALL).frames[0]
    light = frame.reference.half_a / frame.gbuffer.albedo
    spread = light.amax(1) - light.amin(1)
    assert spread[frame.gbuffer.depth[:, 0].isfinite()].max() < 1e-5
    assert torch.equal(frame.reference.half_a, frame.reference.half_b)


def factors(frame: Frame) -> torch.Tensor:
    """[s pixels] Samples divided by the reference, without the sky; the noise has no colour."""
    ratio = frame.pool.radiance[0, :, 0] / frame.reference.half_a[0, 0]
    return ratio[:, frame.gbuffer.depth[0, 0].isfinite()].double()


@pytest.mark.parametrize("part", ["calm", "rough"])
def test_calm_and_rough_pixels_are_both_unbiased(part):
    noise = factors(procedural_clip(1, Size(1, 24, 32), pool_spp=2000).frames[0])
    first, second = noise.split(1000)  # one half selects the pixels, the other is tested
    spread = first.std(0)
    selected = second[:, (spread > spread.median()) == (part == "rough")]
    assert abs(selected.mean() - 1) < 4 * selected.std() / math.sqrt(selected.numel())


def test_the_noise_varies_in_space():
    spread = factors(procedural_clip(size=Size(1, 24, 32), pool_spp=500).frames[0]).std(0)
    low, high = torch.quantile(spread, torch.tensor([0.05, 0.95], dtype=torch.float64))
    assert high > 1.5 * low


def test_the_sky_has_no_noise_and_colours_share_theirs():
    frame = procedural_clip(size=Size(1, 24, 32)).frames[0]
    noise = frame.pool.radiance - frame.reference.half_a[:, None]
    assert (noise.where(frame.gbuffer.depth[:, None].isinf(), 0.0) == 0).all()
    ratio = frame.pool.radiance / frame.reference.half_a[:, None]
    assert_close(ratio[:, :, 0], ratio[:, :, 2], atol=0, rtol=1e-5)  # float32


def test_fireflies_are_as_rare_as_they_should_be():
    noise = factors(procedural_clip(size=Size(1, 48, 64), pool_spp=64).frames[0])
    # a firefly is 60 times a log-normal; values above 25 are hardly ever anything else
    assert (noise > 25).double().mean().item() == pytest.approx(0.003, rel=0.3)


# Seeds


def test_the_same_seed_gives_the_same_clip_and_another_seed_another():
    first, second, other = (tensors(procedural_clip(s, SMALL).frames[2]) for s in (4, 4, 5))
    assert all(torch.equal(first[k], second[k]) for k in first)
    assert not any(torch.equal(first[k], other[k]) for k in first)


def test_a_batch_of_two_is_two_clips():
    both = procedural_clip(7, Size(2, 12, 16)).frames[1]
    alone = [procedural_clip(seed, SMALL).frames[1] for seed in (7, 8)]
    joined = {k: torch.cat([tensors(f)[k] for f in alone]) for k in tensors(both)}
    assert all(torch.equal(tensors(both)[k], joined[k]) for k in joined)
    assert both.pool.rounding_seeds == alone[0].pool.rounding_seeds + alone[1].pool.rounding_seeds


def test_frames_of_a_static_clip_differ_in_noise_and_rounding_seeds_alone():
    first, second = procedural_clip(size=SMALL, static=True).frames[:2]
    assert torch.equal(first.reference.half_a, second.reference.half_a)
    assert not torch.equal(first.pool.radiance, second.pool.radiance)
    assert first.pool.rounding_seeds != second.pool.rounding_seeds
    assert second.gbuffer.motion is None


def test_a_cut_shows_another_world_from_its_frame_on():
    with_cut, without = (procedural_clip(size=SMALL, cut=at, frames=4) for at in (2, None))
    same = [
        torch.equal(a.gbuffer.depth, b.gbuffer.depth)
        for a, b in zip(with_cut, without, strict=True)
    ]
    assert same == [True, True, False, False]


@pytest.mark.parametrize("change", [{"seed": 1}, {"cut": 2}, {"speed": 2.0}, {"pool_spp": 4}])
def test_the_digest_differs_between_clips(change):
    assert procedural_clip(size=SMALL, **change).digest != procedural_clip(size=SMALL).digest


@pytest.mark.parametrize("size", [Size(1, 1, 1), Size(1, 7, 13), Size(3, 33, 2)])
def test_any_size_has_the_shapes_of_the_contract(size):
    n, h, w = size
    frame = procedural_clip(size=size, pool_spp=2).frames[0]
    channels = {"albedo": 3, "normal": 3, "depth": 1, "motion": 2, "a": 3, "b": 3}
    shapes = {k: (n, c, h, w) for k, c in channels.items()} | {"pool": (n, 2, 3, h, w)}
    assert {k: tuple(v.shape) for k, v in tensors(frame).items()} == shapes
    assert {v.dtype for v in tensors(frame).values()} == {torch.float32}


@pytest.mark.parametrize("time", [0, 50, 400, 5000])
def test_all_buffers_but_depth_are_finite_at_any_time(time):
    clip = procedural_clip(size=SMALL, frames=time + 1, speed=3.0)
    frame = tensors(clip.frames[time])
    assert all(v.isfinite().all() for k, v in frame.items() if k != "depth")


def test_with_a_still_camera_only_the_spheres_move():
    clip = procedural_clip(3, Size(1, 48, 64), 2, 1, still_camera=True)
    first, second = (frame.gbuffer for frame in clip)
    moving = second.motion.abs().amax(1) > 1e-3
    assert 0.02 < moving.float().mean() < 0.4
    near = torch.nn.functional.max_pool2d(moving.float(), 9, 1, 4) > 0  # where spheres were before
    assert torch.equal(first.depth[:, 0][~near], second.depth[:, 0][~near])
