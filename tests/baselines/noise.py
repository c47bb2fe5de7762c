"""Clips of noise around known light, and samples of their frames."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import Frame, GBuffer, Reference, Samples, Size, StoredPool

SMALL = Size(1, 16, 16)


def random_tensor(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def exponential_noise(*shape: int, seed: int = 0) -> Tensor:
    """Noise of mean and deviation 1."""
    return -random_tensor(*shape, seed=seed).clamp_min(1e-6).log()


def array(image: Tensor) -> np.ndarray:
    """[h w c] in double precision."""
    return image[0].permute(1, 2, 0).double().numpy()


def one_sample(radiance: Tensor) -> Samples:
    """One sample in each pixel."""
    n, _, h, w = radiance.shape
    return Samples(radiance[:, None], torch.ones(n, 1, h, w, dtype=torch.int64))


def read_samples(frame: Frame, count: int | Tensor = 8) -> Samples:
    """The same number in each pixel, or the given counts."""
    empty = frame.pool.empty()
    counts = empty.counts + count
    return Samples(frame.pool.read(empty, counts), counts)


def wall(h: int, w: int, motion: Tensor | None = None, **changed: Tensor) -> GBuffer:
    """The G-buffer of a white wall that faces the camera."""
    buffers = {
        "albedo": torch.ones(1, 3, h, w),
        "normal": torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).repeat(1, 1, h, w),
        "depth": torch.full((1, 1, h, w), 5.0),
        **changed,
    }
    if motion is not None:
        buffers["motion"] = motion
    return GBuffer(buffers, static=motion is None)


def noisy_clip(frames: int = 3, size: Size = SMALL, seed: int = 0) -> InMemoryClip:
    """Noise around smooth light on a coloured surface, with slow motion."""
    n, h, w = size
    albedo = random_tensor(n, 3, h, w, seed=3)
    reference = random_tensor(n, 3, 1, 1, seed=seed) * torch.linspace(0.2, 2, w) * albedo
    buffers = {
        "albedo": albedo,
        "normal": nn.functional.normalize(random_tensor(n, 3, h, w, seed=2) - 0.5, dim=1),
        "depth": 1 + random_tensor(n, 1, h, w, seed=4),
        "motion": torch.full((n, 2, h, w), 0.5),
    }
    clip_frames = []
    for i in range(frames):
        noise = exponential_noise(n, 8, 1, h, w, seed=seed + i + 1)
        pool = StoredPool(reference[:, None] * noise, tuple(range(i, i + n)))
        clip_frames.append(Frame(i, GBuffer(buffers), pool, Reference(reference, reference)))
    return InMemoryClip("noisy", "noisy", "", clip_frames)


def half_noisy(seed: int, frames: int = 1, side: int = 32) -> InMemoryClip:
    """A static grey image: noise on the left half only, and albedo distinguishes the halves."""
    left = torch.arange(side).expand(1, 1, side, side) < side // 2
    reference = torch.full((1, 3, side, side), 0.5)
    buffers = {
        "albedo": torch.where(left, 0.8, 0.3).expand(1, 3, side, side),
        "normal": torch.zeros(1, 3, side, side),
        "depth": torch.ones(1, 1, side, side),
    }
    clip_frames = []
    for index in range(frames):
        noise = exponential_noise(1, 8, 1, side, side, seed=frames * seed + index)
        pool = StoredPool(torch.where(left[:, None], noise, 1.0) * reference[:, None], (seed,))
        gbuffer = GBuffer(buffers, static=True)
        clip_frames.append(Frame(index, gbuffer, pool, Reference(reference, reference)))
    return InMemoryClip("half noisy", "half noisy", "", clip_frames)


def counts_of_halves(counts: Tensor) -> tuple[float, float]:
    """Mean counts of the left and the right half."""
    left, right = counts.float().mean((0, 1, 2)).view(2, -1).mean(1).tolist()
    return left, right
