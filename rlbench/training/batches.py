"""Training batches: random crops of random clips, augmented alike over all frames of a sequence."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from rlbench.clips.stored import DEFAULT_INPUTS, InMemoryClip, StoredClip, open_clip
from rlbench.errors import RlbenchError
from rlbench.family import Traits
from rlbench.frames import Frame, GBuffer, Reference, StoredPool
from rlbench.training.task import TrainingConfig

__all__ = [
    "TRAINING_INPUTS",
    "Augmentation",
    "BatchError",
    "Batches",
    "pool_slots",
    "prefetch",
    "sample_budget",
    "sequence_budget",
]

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
        return self.transform(image)[..., list(self.channels), :, :]

    def transform_motion(self, motion: Tensor) -> Tensor:
        """Motion [n 2 h w], transformed as an image; the vectors are reflected too."""
        sign = motion.new_tensor([-1.0 if self.mirror else 1.0, -1.0 if self.flip else 1.0])
        motion = self.transform(motion) * sign.view(1, 2, 1, 1)
        return motion.flip(1) if self.transpose else motion

    def apply(self, frame: Frame) -> Frame:
        """The frame, transformed; a frame without motion gets zeros, so that clips can be mixed."""
        pool, reference = frame.pool, frame.reference
        assert isinstance(pool, StoredPool)
        return Frame(
            frame.index,
            GBuffer(self._transform_buffers(frame.gbuffer)),
            StoredPool(self.permute_channels(pool.radiance) * self.gain, pool.rounding_seeds),
            Reference(
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

    Every clip of `clips` is drawn with equal probability. With `mixed_in`, a crop is from one of
    those with probability `mix`, and from `clips` otherwise. Clips may differ in size, length and
    stored samples: the clips of one batch have equally many samples, and the longer ones end with
    the shortest. Each clip's own share is the same as without batches.

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
        inputs = self.inputs | TRAINING_INPUTS
        return tuple(
            open_clip(folder, inputs, pool=self.pool, device=self.device)
            for folder in (*self.clips, *self.mixed_in)
        )

    def clip_digests(self) -> list[str]:
        """Name and hash of each clip, for model cards and checkpoints."""
        return [f"{clip.name} {clip.digest[:12]}" for clip in self.stored_clips]

    def sequence(self, index: int) -> InMemoryClip:
        """A clip with a batch of crops as its frames; as long as the shortest of them."""
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + index)
        first = self._draw_clip(generator, range(len(self.stored_clips)))
        slots = self.stored_clips[first].max_samples
        alike = [n for n, clip in enumerate(self.stored_clips) if clip.max_samples == slots]
        crops = [self._draw_crop(generator, first)]
        for _ in range(1, self.batch):
            crops.append(self._draw_crop(generator, self._draw_clip(generator, alike)))
        frames = [_stack(batch) for batch in zip(*crops, strict=False)]
        return InMemoryClip(f"sequence {index}", "training", "", frames)

    def _draw_clip(self, generator: torch.Generator, candidates: Sequence[int]) -> int:
        """One of the candidates, each with its probability given that it is one of them."""
        group = [number for number in candidates if number < len(self.clips)]
        if self.mixed_in:
            mixed = candidates[len(group) :]
            share = (1 - self.mix) * len(group) / len(self.clips)
            total = share + self.mix * len(mixed) / len(self.mixed_in)
            is_mixed = float(torch.rand((), generator=generator)) * total >= share
            group = list(mixed) if is_mixed else group
        return group[_draw_integer(generator, len(group))]

    def _draw_crop(self, generator: torch.Generator, number: int) -> list[Frame]:
        sample_order = _draw_integer(generator, 2**31)
        clip = replace(self.stored_clips[number], seed=sample_order)
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
        return [augmentation.apply(clip.frame(index, window)) for index in indices]


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
    return min(sample_budget(budgets, seed, index), float(pool_slots(clip.frames[0])))


def pool_slots(frame: Frame) -> int:
    """The number of stored samples per pixel of a frame."""
    assert isinstance(frame.pool, StoredPool)
    return frame.pool.radiance.shape[1]


@contextmanager
def prefetch(batches: Batches) -> Iterator[Callable[[int], InMemoryClip]]:
    """`Batches.sequence`, with the next sequence read in a thread of its own.

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


def _stack(frames: Sequence[Frame]) -> Frame:
    if len(frames) == 1:
        return frames[0]
    names = frames[0].gbuffer.buffers
    pools = [frame.pool for frame in frames]
    gbuffer = GBuffer({k: torch.cat([f.gbuffer.buffers[k] for f in frames]) for k in names})
    radiance = torch.cat([p.radiance for p in pools if isinstance(p, StoredPool)])
    rounding_seeds = tuple(seed for pool in pools for seed in pool.rounding_seeds)
    half_a = torch.cat([f.reference.half_a for f in frames])
    half_b = torch.cat([f.reference.half_b for f in frames])
    pool = StoredPool(radiance, rounding_seeds)
    return Frame(frames[0].index, gbuffer, pool, Reference(half_a, half_b))
