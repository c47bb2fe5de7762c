"""What a renderer hands over: the view of a frame, its references, and clips of frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor

BUFFERS = ("albedo", "normal", "depth", "motion")  # 3 + 3 + 1 + 2 channels


class Size(NamedTuple):
    """Clips advanced together, and the pixels of each."""

    n: int
    h: int
    w: int


@dataclass(frozen=True)
class GBuffer:
    """What the renderer knows of a frame before any light path is traced.

    albedo [n 3 h w] in [0, 1]; normal [n 3 h w] world space, unit length, zero for background;
    depth [n 1 h w] along the view axis, +inf for background; motion [n 2 h w] in pixels, from a
    pixel to its position in the previous frame, x right and y down; outside the image where nothing
    is remembered: for what has just come into view, and for every pixel where another shot begins.
    A buffer that was not declared as needed is absent, and reading it is an error. `motion` is None
    where nothing moves. Some clips have more, see `rlbench.render.mitsuba.gbuffer`: object,
    albedo_first and, of what lies behind glass and mirrors, normal_behind, depth_behind and
    object_behind. A method that declares them runs on these clips alone, and reads them by `extra`.
    """

    buffers: Mapping[str, Tensor]
    static: bool = False

    @property
    def albedo(self) -> Float[Tensor, "n 3 h w"]:
        """Share of light that the first surface reflects, in [0, 1]."""
        return self._read("albedo")

    @property
    def normal(self) -> Float[Tensor, "n 3 h w"]:
        """World-space unit normals; zero for background."""
        return self._read("normal")

    @property
    def depth(self) -> Float[Tensor, "n 1 h w"]:
        """Linear distance along the view axis; +inf for background."""
        return self._read("depth")

    @property
    def motion(self) -> Float[Tensor, "n 2 h w"] | None:
        """Pixels from here to the same point in the previous frame; None where nothing moves."""
        return None if self.static else self._read("motion")

    def extra(self, name: str) -> Float[Tensor, "n c h w"]:
        """A buffer that only some clips have, by its name."""
        return self._read(name)

    def select(self, inputs: frozenset[str]) -> GBuffer:
        """The same view without the buffers that a method did not declare."""
        return GBuffer({k: v for k, v in self.buffers.items() if k in inputs}, self.static)

    def _read(self, name: str) -> Tensor:
        if name not in self.buffers:
            have = ", ".join(self.buffers) or "none"
            raise LookupError(f"view buffer '{name}' was read but not declared; declared: {have}")
        return self.buffers[name]


@dataclass(frozen=True)
class Reference:
    """Two independent halves of the converged image, so that its own noise can be measured."""

    half_a: Float[Tensor, "n 3 h w"]
    half_b: Float[Tensor, "n 3 h w"]

    @property
    def mean(self) -> Float[Tensor, "n 3 h w"]:
        """The reference: the mean of both halves."""
        return (self.half_a + self.half_b) / 2


@dataclass(frozen=True)
class Frame:
    """One frame as the bench holds it. A method never receives it, for it holds the reference."""

    index: int
    gbuffer: GBuffer
    pool: Pool
    reference: Reference


class Clip(Protocol):
    """A run of frames of one scene, read in order. Radiance is linear, 1.0 is display white."""

    @property
    def name(self) -> str:
        """The clip's name, unique within a benchmark."""

    @property
    def scene(self) -> str:
        """The scene that it shows; clips of one scene share their cost per sample."""

    @property
    def size(self) -> Size:
        """Clips in the batch and pixels of each."""

    @property
    def digest(self) -> str:
        """Hash of the content, so that equal numbers come from equal pixels."""

    def __len__(self) -> int:
        """Number of frames."""

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order."""


@dataclass(frozen=True)
class Samples:
    """What was bought. Slots beyond a pixel's count are zero: what was not bought is not here."""

    radiance: Float[Tensor, "n s 3 h w"]  # linear; slots 0 .. count-1 are filled
    counts: Int[Tensor, "n 1 h w"]

    @property
    def valid_mask(self) -> Tensor:
        """[n s 1 h w] True where a slot holds a bought sample."""
        slots = torch.arange(self.radiance.shape[1], device=self.counts.device)
        return slots.view(1, -1, 1, 1, 1) < self.counts.unsqueeze(1)

    @property
    def mean(self) -> Float[Tensor, "n 3 h w"]:
        """The Monte-Carlo average; zero where nothing was bought."""
        return self.radiance.sum(1) / self.counts.clamp_min(1)

    def since(self, before: Samples) -> Samples:
        """Those bought since `pilot`, in slots from 0 on: independent of what decided on them."""
        stored = self.radiance.shape[1]
        slots = torch.arange(stored, device=self.counts.device).view(1, -1, 1, 1, 1)
        moved = (slots + before.counts.unsqueeze(1)).clamp_max(stored - 1)
        radiance = self.radiance.gather(1, moved.expand_as(self.radiance))
        rest = Samples(radiance, self.counts - before.counts)
        return Samples(radiance.where(rest.valid_mask, 0.0), rest.counts)


class Pool(Protocol):
    """Where the samples of a frame come from: stored images, or a live path tracer."""

    @property
    def size(self) -> Size:
        """Clips in the batch and pixels of each."""

    @property
    def max_samples(self) -> int:
        """Most samples that one pixel can have."""

    @property
    def rounding_seeds(self) -> tuple[int, ...]:
        """One number a clip in the batch, another in each frame: decides who is rounded up."""

    def read(self, before: Samples, counts: Int[Tensor, "n 1 h w"]) -> Float[Tensor, "n s 3 h w"]:
        """Radiance of the first `counts` samples of each pixel, those of `before` included."""

    def empty(self) -> Samples:
        """No samples at all, on the pool's device."""


@dataclass(frozen=True)
class StoredPool:
    """A pool of independent 1-spp images, sold in the order in which they lie."""

    radiance: Float[Tensor, "n s 3 h w"]
    rounding_seeds: tuple[int, ...]

    @property
    def size(self) -> Size:
        """Clips in the batch and pixels of each."""
        n, _, _, h, w = self.radiance.shape
        return Size(n, h, w)

    @property
    def max_samples(self) -> int:
        """Number of stored images."""
        return self.radiance.shape[1]

    def read(self, before: Samples, counts: Int[Tensor, "n 1 h w"]) -> Float[Tensor, "n s 3 h w"]:
        """The first `counts` stored values of each pixel, zero elsewhere (also where NaN was)."""
        return self.radiance.where(Samples(self.radiance, counts).valid_mask, 0.0)

    def empty(self) -> Samples:
        """No samples at all."""
        n, h, w = self.size
        counts = torch.zeros(n, 1, h, w, dtype=torch.int64, device=self.radiance.device)
        return Samples(torch.zeros_like(self.radiance), counts)
