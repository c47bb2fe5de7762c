"""Training batches: random crops of random clips, augmented alike over all frames of a sequence.

On a GPU the clips lie in its memory, and crops are cut there, behind the step that still runs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence, Set
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor

from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.stored import DEFAULT_INPUTS, StoredClip, open_clip, sample_order
from rlbench.errors import RlbenchError
from rlbench.family import Traits
from rlbench.frames import Frame, GBuffer, Reference, Size, StoredPool
from rlbench.ops.sanitize import sanitize_radiance
from rlbench.ops.upload import upload
from rlbench.sanitize import sanitize_frame
from rlbench.training.task import TrainingConfig

TRAINING_INPUTS = frozenset({"albedo", "normal", "motion"})  # read for every method


class BatchError(RlbenchError, ValueError):
    """Clips from which no batch can be cut."""


@dataclass(frozen=True)
class Augmentation:
    """How a crop is transformed. Drawn once for each sequence and kept over its frames."""

    mirror: bool  # swap left and right
    flip: bool  # swap top and bottom
    transpose: bool  # swap rows and columns
    gain: float  # exposure, a factor on radiance
    channels: tuple[int, ...]  # a permutation of red, green and blue, of radiance and albedo

    def transform(self, image: Tensor) -> Tensor:
        """An image [... h w], mirrored, flipped and transposed."""
        axes = [axis for axis, reverse in ((-1, self.mirror), (-2, self.flip)) if reverse]
        image = image.flip(axes) if axes else image
        return image.transpose(-1, -2) if self.transpose else image

    def permute_channels(self, image: Tensor) -> Tensor:
        """Radiance or albedo [... 3 h w], transformed, with permuted colour channels."""
        image = self.transform(image)
        return torch.stack([image.select(-3, channel) for channel in self.channels], -3)

    def transform_motion(self, motion: Tensor) -> Tensor:
        """Motion [n 2 h w], transformed as an image; the vectors are reflected too."""
        x, y = self.transform(motion).unbind(1)
        x, y = -x if self.mirror else x, -y if self.flip else y
        return torch.stack((y, x) if self.transpose else (x, y), 1)

    def apply(self, frame: Frame) -> Frame:
        """The frame, transformed; a frame without motion gets zeros, so that clips can be mixed."""
        pool, reference = frame.pool, frame.reference
        assert isinstance(pool, StoredPool)
        return replace(
            frame,
            gbuffer=GBuffer(self._transform_buffers(frame.gbuffer)),
            pool=StoredPool(self.permute_channels(pool.radiance) * self.gain, pool.rounding_seeds),
            reference=Reference(
                self.permute_channels(reference.half_a) * self.gain,
                self.permute_channels(reference.half_b) * self.gain,
            ),
        )

    def _transform_buffers(self, gbuffer: GBuffer) -> dict[str, Tensor]:
        motion = gbuffer.motion
        if motion is None:
            motion = torch.zeros_like(gbuffer.normal[:, :2])
        buffers = {
            name: self.permute_channels(buffer) if "albedo" in name else self.transform(buffer)
            for name, buffer in gbuffer.buffers.items()
            if name != "motion"
        }
        return buffers | {"motion": self.transform_motion(motion)}


@dataclass(frozen=True)
class Batches:
    """Random sequences of crops; sequence `index` is the same in every run with the same seed.

    Every clip of `clips` is drawn with equal probability, and none in two sequences that follow
    each other, if there are others. With `mixed_in`, a crop is from one of those with probability
    `mix`, and from `clips` otherwise. Clips may differ in size, length and stored samples: the
    clips of one batch have equally many samples, and the longer ones end with the shortest. Each
    clip's own share is the same as without batches.

    Raises BatchError if there are no clips, or if a drawn clip is smaller than a crop.
    """

    clips: Sequence[Path]  # clip folders
    batch: int  # clips stacked in a batch
    crop: int  # side of a crop, pixels; no larger than a clip
    sequence_length: int  # frames
    seed: int
    device: str = "cpu"
    pool: str = "path"  # kind of sample pool
    inputs: frozenset[str] = (
        DEFAULT_INPUTS  # G-buffer channels to load besides albedo, normal and motion
    )
    mixed_in: Sequence[Path] = ()  # clip folders that are drawn less or more often
    mix: float = 0.0  # share of crops from `mixed_in`; 0 without

    @classmethod
    def from_config(
        cls,
        clips: Sequence[Path],
        config: TrainingConfig,
        traits: Traits,
        device: str,
        mixed_in: Sequence[Path] = (),
    ) -> Batches:
        """Batches for a training config and a method with these traits."""
        shape = (config.batch, config.crop, config.sequence_length)
        return cls(
            clips, *shape, config.seed, device, traits.pool, traits.inputs, mixed_in, config.mix
        )

    def __post_init__(self) -> None:
        """Raise BatchError if there are no clips, or if `mix` and `mixed_in` contradict."""
        if not self.clips:
            raise BatchError(
                "There are no clips to train on. To render some: rlbench render --preset train"
            )
        if not (0 < self.mix < 1 if self.mixed_in else self.mix == 0):
            raise BatchError(
                f"{len(self.mixed_in)} clips are mixed in at a share of {self.mix:g}. Give clips "
                "and a share between 0 and 1, or neither"
            )

    @cached_property
    def stored_clips(self) -> tuple[StoredClip, ...]:
        """All clips in order, first those that are not mixed in; opened once."""
        return tuple(map(self._open, (*self.clips, *self.mixed_in)))

    @cached_property
    def _sources(self) -> tuple[StoredClip | ResidentClip, ...]:
        """What crops are cut from: copies in the memory of a GPU, or the files."""
        return tuple(map(self._load, self.stored_clips))

    def _open(self, folder: Path) -> StoredClip:
        inputs = self.inputs | TRAINING_INPUTS
        return open_clip(folder, inputs, pool=self.pool, device=self.device)

    def _load(self, clip: StoredClip) -> StoredClip | ResidentClip:
        is_on_gpu = torch.device(self.device).type == "cuda"
        return ResidentClip.load(clip) if is_on_gpu else clip

    def with_clips(self, clips: Sequence[Path]) -> Batches:
        """These batches with other `clips`; those that stay are not read again."""
        folders = (*self.clips, *self.mixed_in)
        opened = dict(zip(folders, zip(self.stored_clips, self._sources, strict=True), strict=True))
        for folder in set(clips) - set(opened):
            clip = self._open(folder)
            opened[folder] = clip, self._load(clip)
        renewed = replace(self, clips=clips)
        kept = [opened[folder] for folder in (*clips, *self.mixed_in)]
        stored, sources = zip(*kept, strict=True)
        vars(renewed).update(stored_clips=stored, _sources=sources)
        return renewed

    def clip_digests(self) -> list[str]:
        """Name and hash of each clip, for model cards and checkpoints."""
        return [f"{clip.name} {clip.digest[:12]}" for clip in self.stored_clips]

    def sequence(self, index: int) -> InMemoryClip:
        """A clip with a batch of crops as its frames; as long as the shortest of them."""
        drawn, generator = self._draw_clips(index)
        crops = [self._draw_crop(generator, number) for number in drawn]
        return InMemoryClip(f"sequence {index}", "training", "", _interleave(crops))

    def _draw_clips(self, index: int) -> tuple[list[int], torch.Generator]:
        """The clips of a sequence, which store equally many samples; and what draws the rest of it.

        Sequences with odd numbers avoid the clips of both neighbours, if their group has others.
        """
        neighbours = (index - 1, index + 1) if index % 2 else ()
        avoided = {number for each in neighbours for number in self._draw_clips(each)[0]}
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + index)
        drawn = [self._draw_clip(generator, range(len(self.stored_clips)), avoided)]
        slots = self.stored_clips[drawn[0]].max_samples
        alike = [n for n, clip in enumerate(self.stored_clips) if clip.max_samples == slots]
        for _ in range(1, self.batch):
            drawn.append(self._draw_clip(generator, alike, avoided))
        return drawn, generator

    def _draw_clip(
        self, generator: torch.Generator, candidates: Sequence[int], avoided: Set[int]
    ) -> int:
        """One of the candidates, each with its probability given that it is one of them."""
        group = [number for number in candidates if number < len(self.clips)]
        if self.mixed_in:
            mixed = candidates[len(group) :]
            share = (1 - self.mix) * len(group) / len(self.clips)
            total = share + self.mix * len(mixed) / len(self.mixed_in)
            is_mixed = float(torch.rand((), generator=generator)) * total >= share
            group = list(mixed) if is_mixed else group
        group = [number for number in group if number not in avoided] or group
        return group[_draw_integer(generator, len(group))]

    def _draw_crop(self, generator: torch.Generator, number: int) -> Frame:
        """A sequence of crops, with its frames as a batch."""
        sample_order = _draw_integer(generator, 2**31)
        clip = self._sources[number]
        if self.crop > min(clip.size.h, clip.size.w):
            raise BatchError(
                f"Crops of {self.crop} x {self.crop} pixels were requested, but clip '{clip.name}' "
                f"has {clip.size.h} x {clip.size.w} pixels. Choose a smaller --crop"
            )
        top = _draw_integer(generator, clip.size.h - self.crop + 1)
        left = _draw_integer(generator, clip.size.w - self.crop + 1)
        window = (slice(top, top + self.crop), slice(left, left + self.crop))
        augmentation = _draw_augmentation(generator)
        first = _draw_integer(generator, max(1, len(clip) - self.sequence_length + 1))
        indices = range(first, min(first + self.sequence_length, len(clip)))
        return augmentation.apply(_cut(replace(clip, seed=sample_order), indices, window))


@dataclass(frozen=True)
class ResidentClip:
    """A clip whose frames lie in the memory of a device, sanitised once."""

    stored: StoredClip
    frame: Frame  # its batch is the frames of the clip, with all samples in stored order
    seed: int = 0  # of the sample order and of rounding

    @classmethod
    def load(cls, clip: StoredClip) -> ResidentClip:
        """Read all frames and samples of a clip to its device."""
        everything = replace(clip, max_samples=clip.header.pool_spp)
        frame = _cut(everything, range(len(clip)), (slice(None), slice(None)))
        assert isinstance(frame.pool, StoredPool)
        samples = torch.empty_like(frame.pool.radiance)
        for index in range(len(clip)):
            order, _ = sample_order(clip.seed, clip.name, index, clip.header.pool_spp)
            samples[index, order] = frame.pool.radiance[index]
        gbuffer = sanitize_frame(frame, clip.inputs).gbuffer
        pool = StoredPool(sanitize_radiance(samples), frame.pool.rounding_seeds)
        return cls(clip, replace(frame, gbuffer=gbuffer, pool=pool, is_sanitized=True))

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.stored)

    @property
    def name(self) -> str:
        """The clip's name."""
        return self.stored.name

    @property
    def size(self) -> Size:
        """One clip, and height and width of its images."""
        return self.stored.size

    def cut(self, indices: range, window: tuple[slice, slice]) -> Frame:
        """A window of some frames, which are its batch; images are views of those in memory."""
        assert isinstance(self.frame.pool, StoredPool)
        samples, most = self.frame.pool.radiance, self.stored.max_samples
        orders = [sample_order(self.seed, self.name, index, samples.shape[1]) for index in indices]
        order = upload([slots[:most] for slots, _ in orders], samples.device)
        frames = slice(indices.start, indices.stop)
        rows = torch.arange(len(indices), device=order.device)[:, None]
        drawn = samples[frames, :, :, *window][rows, order]
        gbuffer, reference = self.frame.gbuffer, self.frame.reference
        buffers = {k: v[frames, :, *window] for k, v in gbuffer.buffers.items()}
        halves = [half[frames, :, *window] for half in (reference.half_a, reference.half_b)]
        return replace(
            self.frame,
            index=indices.start,
            gbuffer=GBuffer(buffers, gbuffer.static),
            pool=StoredPool(drawn, tuple(seed for _, seed in orders)),
            reference=Reference(*halves),
        )


def _cut(clip: StoredClip | ResidentClip, indices: range, window: tuple[slice, slice]) -> Frame:
    """A window of some frames of a clip, which are the batch of one frame."""
    if isinstance(clip, ResidentClip):
        return clip.cut(indices, window)
    frames = [clip.frame(index, window) for index in indices]
    gbuffers = [frame.gbuffer for frame in frames]
    buffers = {k: torch.cat([each.buffers[k] for each in gbuffers]) for k in gbuffers[0].buffers}
    pools = [frame.pool for frame in frames if isinstance(frame.pool, StoredPool)]
    return Frame(
        indices.start,
        GBuffer(buffers, gbuffers[0].static),
        StoredPool(
            torch.cat([pool.radiance for pool in pools]),
            tuple(seed for pool in pools for seed in pool.rounding_seeds),
        ),
        Reference(
            torch.cat([frame.reference.half_a for frame in frames]),
            torch.cat([frame.reference.half_b for frame in frames]),
        ),
    )


def _interleave(crops: Sequence[Frame]) -> list[Frame]:
    """The frames of a sequence whose batch is the crops, from crops whose batch is the frames.

    It is as long as the shortest of them.
    """
    pools = [crop.pool for crop in crops if isinstance(crop.pool, StoredPool)]
    seeds = list(zip(*(pool.rounding_seeds for pool in pools), strict=False))

    def stack(images: list[Tensor]) -> Tensor:
        """Images [frames crops ...] of images [frames ...] of each crop."""
        return torch.stack([image[: len(seeds)] for image in images], 1)

    names = crops[0].gbuffer.buffers
    buffers = {k: stack([crop.gbuffer.buffers[k] for crop in crops]) for k in names}
    radiance = stack([pool.radiance for pool in pools])
    half_a = stack([crop.reference.half_a for crop in crops])
    half_b = stack([crop.reference.half_b for crop in crops])
    return [
        replace(
            crops[0],
            index=crops[0].index + frame,
            gbuffer=GBuffer({k: images[frame] for k, images in buffers.items()}),
            pool=StoredPool(radiance[frame], seeds[frame]),
            reference=Reference(half_a[frame], half_b[frame]),
        )
        for frame in range(len(seeds))
    ]


def sample_budget(budgets: Sequence[float], seed: int, index: int) -> float:
    """The budget of sequence `index` in a run with that seed, in samples per pixel.

    It is hashed from the index, independently of the clip: with one generator for both, some scenes
    would never be seen at some budgets.

    >>> [sample_budget((1.0, 2.0, 4.0), seed=0, index=index) for index in range(4)]
    [1.0, 2.0, 1.0, 1.0]
    """
    key = hashlib.blake2b(f"{seed}/{index}/budget".encode(), digest_size=8).digest()
    return budgets[int.from_bytes(key) % len(budgets)]


def sequence_budget(clip: InMemoryClip, budgets: Sequence[float], seed: int, index: int) -> float:
    """The budget of sequence `index`, but no more than the samples that its clips store."""
    pool = clip.frames[0].pool
    assert isinstance(pool, StoredPool)
    return min(sample_budget(budgets, seed, index), float(pool.radiance.shape[1]))


class SequenceSource(Protocol):
    """What `prefetch` reads from."""

    def sequence(self, index: int) -> InMemoryClip:
        """The crops of a sequence."""


@contextmanager
def prefetch(batches: SequenceSource) -> Iterator[Callable[[int], InMemoryClip]]:
    """`batches.sequence`, with the next sequence read in a thread of its own.

    The sequences are the same as without. An error while reading a sequence is raised when that
    sequence is requested.
    """
    pending: dict[int, Future[InMemoryClip]] = {}
    with ThreadPoolExecutor(1, thread_name_prefix="prefetch") as reader:

        def sequence(index: int) -> InMemoryClip:
            future = pending.pop(index, None) or reader.submit(batches.sequence, index)
            pending.clear()
            clip = future.result()
            pending[index + 1] = reader.submit(batches.sequence, index + 1)
            return clip

        yield sequence


def _draw_augmentation(generator: torch.Generator) -> Augmentation:
    mirror, flip, transpose = (bool(_draw_integer(generator, 2)) for _ in range(3))
    gain = 2.0 ** float(torch.rand((), generator=generator) - 0.5)
    channels = tuple(torch.randperm(3, generator=generator).tolist())
    return Augmentation(mirror, flip, transpose, gain, channels)


def _draw_integer(generator: torch.Generator, below: int) -> int:
    return int(torch.randint(below, (), generator=generator))
