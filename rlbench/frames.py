"""The data of a frame: G-buffer, sample pool, drawn samples, reference; and clips of frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

__all__ = [
    "BUFFERS",
    "Clip",
    "Frame",
    "GBuffer",
    "Pool",
    "PoolWrapper",
    "Reference",
    "Samples",
    "Size",
    "StoredPool",
]

BUFFERS = ("albedo", "normal", "depth", "motion")  # of every clip: 3 + 3 + 1 + 2 channels


class Size(NamedTuple):
    """Number of clips in the batch, and height and width of each in pixels."""

    n: int
    h: int
    w: int


@dataclass(frozen=True)
class GBuffer:
    """The G-buffer of a frame: geometry and material, known before any light path is traced.

    albedo [n 3 h w] in [0, 1]; normal [n 3 h w] world space, unit length, zero for background;
    depth [n 1 h w] linear distance along the view axis, +inf for background; motion [n 2 h w] in
    pixels, from a pixel to its position in the previous frame, x right and y down. Motion points
    outside the image where there is no valid history: at disoccluded pixels, and at all pixels of
    the first frame of a shot.

    `buffers` maps names to tensors. A method receives only the buffers that it declares in
    Traits(inputs=...); reading any other raises LookupError. `static` is True for a clip without
    camera or object motion; `motion` is None then.

    Some clips have more buffers, to be read by `extra`: object, albedo_first and, for the first
    surface behind glass and mirrors (primary surface replacement), normal_psr, depth_psr and
    object_psr (see docs/concepts/tracing.md). A method that declares one of these runs on
    such clips alone.

    >>> gbuffer = GBuffer({"depth": torch.ones(1, 1, 4, 5)}, static=True)
    >>> gbuffer.depth.shape, gbuffer.motion
    (torch.Size([1, 1, 4, 5]), None)
    """

    buffers: Mapping[str, Tensor]
    static: bool = False

    @property
    def albedo(self) -> Float[Tensor, "n 3 h w"]:
        """Fraction of light that the first surface reflects, in [0, 1]."""
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
        """Motion vectors in pixels to the previous frame, x right and y down; None if static."""
        return None if self.static else self._read("motion")

    def extra(self, name: str) -> Float[Tensor, "n c h w"]:
        """The buffer `name`, which only some clips have. Raises LookupError if it is absent."""
        return self._read(name)

    def select(self, inputs: frozenset[str]) -> GBuffer:
        """The same G-buffer with the buffers named in `inputs` alone."""
        return GBuffer({k: v for k, v in self.buffers.items() if k in inputs}, self.static)

    def _read(self, name: str) -> Tensor:
        if name not in self.buffers:
            declared = ", ".join(self.buffers) or "none"
            raise LookupError(
                f"G-buffer '{name}' was read but not declared; declared: {declared}. "
                f"Add '{name}' to Traits(inputs=...)"
            )
        return self.buffers[name]


@dataclass(frozen=True)
class Reference:
    """The converged image as two independent half references, in linear radiance.

    With independent halves the noise of the reference itself can be measured and removed from the
    squared error: mean((x - half_a) * (x - half_b)) is an unbiased estimate of the true one.
    """

    half_a: Float[Tensor, "n 3 h w"]
    half_b: Float[Tensor, "n 3 h w"]

    @property
    def mean(self) -> Float[Tensor, "n 3 h w"]:
        """The reference image: the mean of both halves."""
        return (self.half_a + self.half_b) / 2


@dataclass(frozen=True)
class Frame:
    """One frame of a clip. Methods never receive it, because it holds the reference."""

    index: int  # from 0
    gbuffer: GBuffer
    pool: Pool
    reference: Reference
    is_sanitized: bool = False  # all values are known to be valid, see rlbench.sanitize


class Clip(Protocol):
    """A sequence of frames of one scene, read in order. Radiance is linear, 1.0 is display white.

    Each frame has a G-buffer, a pool of samples and a pair of half references. A clip may advance
    a batch of n clips of the same size and length together.
    """

    @property
    def name(self) -> str:
        """Name of the clip, unique within a benchmark."""

    @property
    def scene(self) -> str:
        """Name of the scene; clips of one scene share their cost per sample."""

    @property
    def size(self) -> Size:
        """Number of clips in the batch, height and width."""

    @property
    def digest(self) -> str:
        """Hash of the content; results of clips with equal digests are comparable."""

    def __len__(self) -> int:
        """Number of frames."""

    def __iter__(self) -> Iterator[Frame]:
        """The frames in order, from frame 0."""


@dataclass(frozen=True)
class Samples:
    """The samples drawn for a frame, one by one.

    Slots 0 to count-1 of a pixel hold its samples; the others are zero. Samples that the budget did
    not pay for are not in the object. The number of slots s differs between pools. `counts` says
    how many samples each pixel has: an adaptive method's differ, and their mean is the budget. A
    pixel with 0 has a `mean` of zero, and is not black for that.

    >>> radiance = torch.tensor([3.0, 5.0]).view(1, 2, 1, 1, 1).expand(1, 2, 3, 1, 1)
    >>> samples = Samples(radiance, counts=torch.full((1, 1, 1, 1), 2))
    >>> samples.mean.flatten().tolist()
    [4.0, 4.0, 4.0]
    """

    radiance: Float[Tensor, "n s 3 h w"]  # linear
    counts: Int[Tensor, "n 1 h w"]  # samples per pixel, 0 to s
    slot_spp: float = 1.0  # rendered samples behind each one; above 1 in rlbench.denoise alone

    @property
    def valid_mask(self) -> Bool[Tensor, "n s 1 h w"]:
        """True in slots that hold a sample."""
        slots = torch.arange(self.radiance.shape[1], device=self.counts.device)
        return slots.view(1, -1, 1, 1, 1) < self.counts.unsqueeze(1)

    @property
    def mean(self) -> Float[Tensor, "n 3 h w"]:
        """The Monte Carlo estimate: mean radiance per pixel, zero where no sample was drawn."""
        return self.radiance.sum(1) / self.counts.clamp_min(1)

    def since(self, before: Samples) -> Samples:
        """The samples drawn after `before`, moved to slots from 0 on.

        `before` must be an earlier state of the same samples. The returned samples are independent
        of those that determined where to draw them.
        """
        slot_count = self.radiance.shape[1]
        slots = torch.arange(slot_count, device=self.counts.device).view(1, -1, 1, 1, 1)
        sources = (slots + before.counts.unsqueeze(1)).clamp_max(slot_count - 1)
        radiance = self.radiance.gather(1, sources.expand_as(self.radiance))
        rest = Samples(radiance, self.counts - before.counts)
        return Samples(radiance.where(rest.valid_mask, 0.0), rest.counts)


class Pool(Protocol):
    """The source of a frame's samples: stored images or a live path tracer."""

    @property
    def size(self) -> Size:
        """Number of clips in the batch, height and width."""

    @property
    def max_samples(self) -> int:
        """Most samples that one pixel can have."""

    @property
    def rounding_seeds(self) -> tuple[int, ...]:
        """One seed per clip in the batch, different in each frame, for rounding sample counts."""

    def read(self, before: Samples, counts: Int[Tensor, "n 1 h w"]) -> Float[Tensor, "n s 3 h w"]:
        """Radiance of the first `counts` samples of each pixel, including those in `before`.

        `counts` is at least before.counts and at most `max_samples`. Other slots are zero.
        """

    def empty(self) -> Samples:
        """Samples with all counts zero, on the pool's device."""


@dataclass(frozen=True)
class PoolWrapper:
    """A pool that forwards every call to another pool; override the members that differ."""

    pool: Pool

    @property
    def size(self) -> Size:
        """Number of clips in the batch, height and width."""
        return self.pool.size

    @property
    def max_samples(self) -> int:
        """Most samples that one pixel can have."""
        return self.pool.max_samples

    @property
    def rounding_seeds(self) -> tuple[int, ...]:
        """One seed per clip in the batch."""
        return self.pool.rounding_seeds

    def empty(self) -> Samples:
        """Samples with all counts zero."""
        return self.pool.empty()

    def read(self, before: Samples, counts: Int[Tensor, "n 1 h w"]) -> Float[Tensor, "n s 3 h w"]:
        """Radiance of the first `counts` samples of each pixel."""
        return self.pool.read(before, counts)


@dataclass(frozen=True)
class StoredPool:
    """A pool of independent images at 1 spp, drawn in stored order.

    >>> pool = StoredPool(torch.rand(1, 8, 3, 4, 5), rounding_seeds=(0,))
    >>> pool.size, pool.max_samples
    (Size(n=1, h=4, w=5), 8)
    """

    radiance: Float[Tensor, "n s 3 h w"]  # linear
    rounding_seeds: tuple[int, ...]

    @property
    def size(self) -> Size:
        """Number of clips in the batch, height and width."""
        n, _, _, h, w = self.radiance.shape
        return Size(n, h, w)

    @property
    def max_samples(self) -> int:
        """Number of stored images."""
        return self.radiance.shape[1]

    def read(self, before: Samples, counts: Int[Tensor, "n 1 h w"]) -> Float[Tensor, "n s 3 h w"]:
        """The first `counts` stored samples of each pixel; other slots are zero, also over NaN."""
        return self.radiance.where(Samples(self.radiance, counts).valid_mask, 0.0)

    def empty(self) -> Samples:
        """Samples with all counts zero."""
        n, h, w = self.size
        counts = torch.zeros(n, 1, h, w, dtype=torch.int64, device=self.radiance.device)
        return Samples(torch.zeros_like(self.radiance), counts)
