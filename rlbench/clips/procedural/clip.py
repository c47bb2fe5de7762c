"""Clips of a closed-form world: exact truth, heavy-tailed samples, any size, from a seed."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import overload

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural import raycast, world
from rlbench.frames import Frame, GBuffer, Reference, Size, StoredPool

FIREFLY = 0.003  # chance that a sample is one
FIREFLY_SCALE = 60.0  # times the truth that a firefly is
NORMAL_SCALE = (1 - FIREFLY * FIREFLY_SCALE) / (
    1 - FIREFLY
)  # of the other samples, so that the mean stays 1
CALM, ROUGH = 0.3, 0.9  # sigma of the logarithm in full light, and what shade adds


def procedural(
    seed: int = 0,
    size: Size = Size(1, 96, 128),  # noqa: B008  (a tuple)
    frames: int = 8,
    pool_spp: int = 8,
    speed: float = 1.0,
    cut: int | None = None,
    static: bool = False,
    device: torch.device | str = "cpu",
) -> InMemoryClip:
    """A clip of `size.n` worlds, of the seeds `seed`, `seed + 1`, ...

    Both halves of the reference are the truth itself. A sample is the truth times noise whose mean
    is exactly 1 (log-normal, wilder in shade, with rare fireflies); the sky has no noise. `speed`
    scales all movement; 1 moves about 2 pixels per frame at a width of 128. From frame `cut` on
    another world is shown, whose motion is still its own: as after an editor's cut, the history is
    wrong and no buffer says so, while at a cut of rendered clips all motion leads outside. `static`
    stops all movement; the noise goes on. Motion leads far outside the image where a point was
    behind the previous camera; in frame 0 it leads to the frame that would have come before.

    Frames are computed anew whenever they are read, and equal whenever they are read.
    """
    told = f"{seed} {tuple(size)} {frames} {pool_spp} {speed} {cut} {static}".encode()
    for module in (raycast.__file__, world.__file__, __file__):
        told += Path(module).read_bytes()
    return InMemoryClip(
        name=f"procedural-{seed}",
        scene="procedural",
        digest=hashlib.sha256(told).hexdigest()[:32],
        frames=_Frames(
            seed, size, frames, pool_spp, 0.0 if static else speed, cut, torch.device(device)
        ),
    )


@dataclass(frozen=True)
class _Frames(Sequence[Frame]):
    """Frames by formula."""

    seed: int
    size: Size
    length: int
    pool_spp: int
    speed: float  # 0 is a static clip
    cut: int | None
    device: torch.device

    def __len__(self) -> int:
        return self.length

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | Sequence[Frame]:
        """One frame, or the frames of a slice."""
        if isinstance(index, slice):
            return tuple(self[i] for i in range(self.length)[index])
        return self._frame(range(self.length)[index])

    @cached_property
    def worlds(self) -> tuple[world.World, world.World]:
        """Before the cut, and from the cut on."""
        first, second = (
            world.random_world([f"{s}/{shot}" for s in self._seeds], self.device) for shot in (0, 1)
        )
        return first, second

    @property
    def _seeds(self) -> range:
        return range(self.seed, self.seed + self.size.n)

    def _frame(self, index: int) -> Frame:
        shot = self.cut is not None and index >= self.cut
        time = index * self.speed
        seen = raycast.raycast(self.worlds[shot], time, time - self.speed, self.size.h, self.size.w)
        buffers = {"albedo": seen.albedo, "normal": seen.normal, "depth": seen.depth}
        if self.speed:
            buffers["motion"] = seen.motion
        truth = seen.radiance.float()
        return Frame(
            index,
            GBuffer({k: v.float() for k, v in buffers.items()}, static=not self.speed),
            StoredPool(truth[:, None] * self._noise(index, seen), self._keys(index)),
            Reference(truth, truth),
        )

    def _noise(self, index: int, seen: raycast.CameraBuffers) -> Float[Tensor, "n s 1 h w"]:
        """Factors of mean 1: exp(sigma z - sigma^2 / 2), times a flash or its lack."""
        shape = (self.pool_spp, 1, self.size.h, self.size.w)
        drawn = []
        for key in self._keys(index):  # on the host, so that every device gets the same numbers
            source = torch.Generator().manual_seed(key)
            pair = (torch.randn(shape, generator=source), torch.rand(shape, generator=source))
            drawn.append(pair)
        z, chance = (torch.stack(part).to(self.device) for part in zip(*drawn, strict=True))
        sigma = (CALM + ROUGH * seen.shade.float())[:, None]
        flash = torch.where(chance < FIREFLY, FIREFLY_SCALE, NORMAL_SCALE)
        noise = torch.exp(sigma * z - sigma.square() / 2) * flash
        return noise.where(seen.depth[:, None].isfinite(), 1.0)

    def _keys(self, index: int) -> tuple[int, ...]:
        """One number a world, from its seed and the frame."""
        told = (f"{seed}/{index}".encode() for seed in self._seeds)
        return tuple(int.from_bytes(hashlib.blake2b(t, digest_size=4).digest()) >> 1 for t in told)
