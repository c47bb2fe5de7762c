"""Procedural clips: exact reference, heavy-tailed samples, any size, from a seed."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.clips.in_memory import ComputedFrames, InMemoryClip
from rlbench.clips.procedural import raycast, world
from rlbench.frames import Frame, GBuffer, Reference, Size, StoredPool

FIREFLY_PROBABILITY = 0.003  # per sample
FIREFLY_SCALE = 60.0  # factor on the noise of a firefly
# factor on the noise of all other samples, so that the mean stays 1
NORMAL_SCALE = (1 - FIREFLY_PROBABILITY * FIREFLY_SCALE) / (1 - FIREFLY_PROBABILITY)
LIT_SIGMA = 0.3  # standard deviation of the noise's logarithm in full light
SHADE_SIGMA = 0.9  # added to it in full shade


def procedural_clip(
    seed: int = 0,
    size: Size = Size(1, 96, 128),  # noqa: B008  (a tuple)
    frames: int = 8,
    pool_spp: int = 8,
    speed: float = 1.0,
    cut: int | None = None,
    static: bool = False,
    device: torch.device | str = "cpu",
    still_camera: bool = False,
) -> InMemoryClip:
    """A batch of `size.n` procedural clips with the seeds `seed`, `seed + 1`, ...

    Both halves of the reference are the noise-free image. A sample is this image times noise with a
    mean of exactly 1: log-normal, stronger in shade, with rare fireflies. The sky has no noise.
    Motion points far outside the image where a point was behind the previous camera. In frame 0 it
    points to where the frame before it would have been. Frames are computed whenever they are read,
    with equal results.

    >>> clip = procedural_clip(seed=1, size=Size(1, 32, 48), frames=2, pool_spp=4)
    >>> frame = clip.frames[0]
    >>> frame.gbuffer.albedo.shape  # n c h w
    torch.Size([1, 3, 32, 48])
    >>> frame.pool.radiance.shape  # n s c h w: 4 samples per pixel
    torch.Size([1, 4, 3, 32, 48])
    >>> frame.reference.mean.shape
    torch.Size([1, 3, 32, 48])

    Args:
        seed: seed of the first clip: scene and noise.
        size: number of clips in the batch, height and width in pixels.
        frames: number of frames.
        pool_spp: samples per pixel in the pool.
        speed: factor on all movement; 1 moves about 2 pixels per frame at a width of 128.
        cut: first frame of a second scene. Its motion is the second scene's own, as after an
            editor's cut: the history is wrong and no buffer says so. At a cut of rendered clips,
            all motion points outside the image.
        static: nothing moves, and there is no motion buffer; the noise still changes.
        device: device of the tensors; the numbers are the same on every device.
        still_camera: only the three spheres move, and their soft shadows.
    """
    options = f"{speed} {cut} {static} {still_camera}"
    content = f"{seed} {tuple(size)} {frames} {pool_spp} {options}".encode()
    for module in (raycast.__file__, world.__file__, __file__):
        content += Path(module).read_bytes()
    speed = 0.0 if static else speed
    renderer = _Renderer(seed, size, pool_spp, speed, cut, torch.device(device), still_camera)
    return InMemoryClip(
        name=f"procedural-{seed}",
        scene="procedural",
        digest=hashlib.sha256(content).hexdigest()[:32],
        frames=ComputedFrames(frames, renderer.render),
    )


@dataclass(frozen=True)
class _Renderer:
    """Computes the frames of procedural clips."""

    seed: int
    size: Size
    pool_spp: int
    speed: float  # 0 for a static clip
    cut: int | None
    device: torch.device
    still_camera: bool

    @cached_property
    def worlds(self) -> tuple[world.World, world.World]:
        """The worlds before the cut, and from the cut on."""
        camera_speed = 0.0 if self.still_camera else 1.0
        first, second = (
            world.random_world([f"{s}/{shot}" for s in self._seeds], self.device, camera_speed)
            for shot in (0, 1)
        )
        return first, second

    @property
    def _seeds(self) -> range:
        return range(self.seed, self.seed + self.size.n)

    def render(self, index: int) -> Frame:
        shot = self.cut is not None and index >= self.cut
        time = index * self.speed
        h, w = self.size.h, self.size.w
        camera = raycast.raycast(self.worlds[shot], time, time - self.speed, h, w)
        buffers = {"albedo": camera.albedo, "normal": camera.normal, "depth": camera.depth}
        if self.speed:
            buffers["motion"] = camera.motion
        truth = camera.radiance.float()
        return Frame(
            index,
            GBuffer({k: v.float() for k, v in buffers.items()}, static=not self.speed),
            StoredPool(truth[:, None] * self._noise(index, camera), self._frame_seeds(index)),
            Reference(truth, truth),
        )

    def _noise(self, index: int, camera: raycast.CameraBuffers) -> Float[Tensor, "n s 1 h w"]:
        """Factors of mean 1: exp(sigma z - sigma^2 / 2), times the scale of fireflies or others."""
        shape = (self.pool_spp, 1, self.size.h, self.size.w)
        draws = []
        for seed in self._frame_seeds(index):  # on the CPU, so that all devices get equal numbers
            generator = torch.Generator().manual_seed(seed)
            pair = (torch.randn(shape, generator=generator), torch.rand(shape, generator=generator))
            draws.append(pair)
        z, uniform = (torch.stack(part).to(self.device) for part in zip(*draws, strict=True))
        sigma = (LIT_SIGMA + SHADE_SIGMA * camera.shade.float())[:, None]
        scale = torch.where(uniform < FIREFLY_PROBABILITY, FIREFLY_SCALE, NORMAL_SCALE)
        noise = torch.exp(sigma * z - sigma.square() / 2) * scale
        return noise.where(camera.depth[:, None].isfinite(), 1.0)

    def _frame_seeds(self, index: int) -> tuple[int, ...]:
        """One seed per clip in the batch, from the clip's seed and the frame number."""
        keys = (f"{seed}/{index}".encode() for seed in self._seeds)
        return tuple(int.from_bytes(hashlib.blake2b(k, digest_size=4).digest()) >> 1 for k in keys)
