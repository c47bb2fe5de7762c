"""Training batches: random crops of random clips, kept over their frames; seeded by draw."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from rlbench.clips.stored import ALL, InMemoryClip, open_clip
from rlbench.errors import RlbenchError
from rlbench.family import Traits
from rlbench.frames import Frame, GBuffer, Reference, StoredPool
from rlbench.training.config import TrainingConfig


class BatchError(RlbenchError, ValueError):
    """Clips of which no batch can be cut."""


@dataclass(frozen=True)
class Augmentation:
    """How a crop is turned. Drawn once a sequence and kept over its frames."""

    mirror: bool  # left to right
    flip: bool  # top to bottom
    transpose: bool  # rows become columns
    gain: float  # exposure, factor on radiance
    colours: tuple[int, ...]  # the order of red, green and blue, in radiance and albedo

    def transform(self, image: Tensor) -> Tensor:
        """An image [... h w], mirrored, flipped and transposed."""
        axes = [axis for axis, wanted in ((-1, self.mirror), (-2, self.flip)) if wanted]
        image = image.flip(axes) if axes else image
        return image.transpose(-1, -2) if self.transpose else image

    def permute_channels(self, image: Tensor) -> Tensor:
        """Radiance or albedo [... 3 h w], turned, with its colours in another order."""
        return self.transform(image)[..., list(self.colours), :, :]

    def transform_motion(self, motion: Tensor) -> Tensor:
        """The same for motion [n 2 h w], whose vectors turn with the image."""
        sign = motion.new_tensor([-1.0 if self.mirror else 1.0, -1.0 if self.flip else 1.0])
        motion = self.transform(motion) * sign.view(1, 2, 1, 1)
        return motion.flip(1) if self.transpose else motion

    def apply(self, frame: Frame) -> Frame:
        """The frame, turned and exposed; a static view gets motion zero, so that clips can mix."""
        gbuffer = frame.gbuffer
        motion = (
            gbuffer.motion
            if gbuffer.motion is not None
            else torch.zeros_like(gbuffer.normal[:, :2])
        )
        kept = {k: v for k, v in gbuffer.buffers.items() if k != "motion"}
        buffers = {
            k: (self.permute_channels if "albedo" in k else self.transform)(v)
            for k, v in kept.items()
        }
        buffers |= {"motion": self.transform_motion(motion)}
        pool = frame.pool
        assert isinstance(pool, StoredPool)
        return Frame(
            frame.index,
            GBuffer(buffers),
            StoredPool(self.permute_channels(pool.radiance) * self.gain, pool.rounding_seeds),
            Reference(
                self.permute_channels(frame.reference.half_a) * self.gain,
                self.permute_channels(frame.reference.half_b) * self.gain,
            ),
        )


@dataclass(frozen=True)
class Batches:
    """Draws of clips for training; draw `index` is the same in every run with the same seed.

    Raises BatchError where there is no clip, and at a draw of one that is smaller than a crop.
    """

    folders: Sequence[Path]
    batch: int  # clips advanced together
    crop: int  # side, pixels; clips are at least as large
    length: int  # frames of a sequence
    seed: int
    device: str = "cpu"
    pool: str = "path"
    inputs: frozenset[str] = ALL  # view buffers, beside those that are turned in a way of their own

    @classmethod
    def planned(
        cls, folders: Sequence[Path], plan: TrainingConfig, traits: Traits, device: str
    ) -> Batches:
        """As a plan has them, for a method of those traits."""
        how = (plan.batch, plan.crop, plan.length, plan.seed)
        return cls(folders, *how, device, traits.pool, traits.inputs)

    def __post_init__(self) -> None:
        """Refuse to draw from nothing."""
        if not self.folders:
            raise BatchError("no clips to train on; 'rlbench render --preset train' makes some")

    def contents(self) -> list[str]:
        """Name and hash of each clip, as cards and checkpoints tell what was trained on."""
        opened = [open_clip(folder, pool=self.pool) for folder in self.folders]
        return [f"{clip.name} {clip.digest[:12]}" for clip in opened]

    def sequence(self, index: int) -> InMemoryClip:
        """A clip of `batch` crops side by side, `length` frames long or as long as the shortest."""
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + index)
        parts = [self._part(generator) for _ in range(self.batch)]
        frames = [_stack(together) for together in zip(*parts, strict=False)]
        return InMemoryClip(f"draw {index}", "training", "", frames)

    def _part(self, generator: torch.Generator) -> list[Frame]:
        folder = self.folders[_integer(generator, len(self.folders))]
        order = _integer(generator, 2**31)
        needs = self.inputs | {"albedo", "normal", "motion"}
        clip = open_clip(folder, needs, pool=self.pool, seed=order, device=self.device)
        if self.crop > min(clip.size.h, clip.size.w):
            raise BatchError(
                f"crops of {self.crop} x {self.crop} asked for, clip '{clip.name}' has "
                f"{clip.size.h} x {clip.size.w} pixels; ask for smaller crops"
            )
        top = _integer(generator, clip.size.h - self.crop + 1)
        left = _integer(generator, clip.size.w - self.crop + 1)
        window = (slice(top, top + self.crop), slice(left, left + self.crop))
        mirror, flip, transpose = (bool(_integer(generator, 2)) for _ in range(3))
        gain = 2.0 ** float(torch.rand((), generator=generator) - 0.5)
        colours = tuple(torch.randperm(3, generator=generator).tolist())
        turned = Augmentation(mirror, flip, transpose, gain, colours)
        first = _integer(generator, max(1, len(clip) - self.length + 1))
        chosen = range(first, min(first + self.length, len(clip)))
        return [turned.apply(clip.frame(i, window)) for i in chosen]


def sample_budget(budgets: Sequence[float], seed: int, draw: int) -> float:
    """The budget, in samples per pixel, of one draw of a training with that seed.

    It is drawn apart from the clip: were both from one generator, some scenes would never be seen
    at some budgets.
    """
    told = hashlib.blake2b(f"{seed}/{draw}/budget".encode(), digest_size=8).digest()
    return budgets[int.from_bytes(told) % len(budgets)]


def _stack(frames: Sequence[Frame]) -> Frame:
    names = frames[0].gbuffer.buffers
    pools = [frame.pool for frame in frames]
    gbuffer = GBuffer({k: torch.cat([f.gbuffer.buffers[k] for f in frames]) for k in names})
    radiance = torch.cat([p.radiance for p in pools if isinstance(p, StoredPool)])
    keys = tuple(key for pool in pools for key in pool.rounding_seeds)
    a = torch.cat([f.reference.half_a for f in frames])
    b = torch.cat([f.reference.half_b for f in frames])
    return Frame(frames[0].index, gbuffer, StoredPool(radiance, keys), Reference(a, b))


def _integer(generator: torch.Generator, below: int) -> int:
    return int(torch.randint(below, (), generator=generator))


@contextmanager
def prefetch(batches: Batches) -> Iterator[Callable[[int], InMemoryClip]]:
    """`Batches.draw`, one draw ahead of what is asked for, in a thread of its own.

    The draws are the same as without. What stops the reading of a draw is raised when that draw is
    asked for.
    """
    waiting: dict[int, Future[InMemoryClip]] = {}
    with ThreadPoolExecutor(1, thread_name_prefix="draw") as reader:

        def draw(index: int) -> InMemoryClip:
            asked = waiting.pop(index, None) or reader.submit(batches.sequence, index)
            waiting.clear()
            clip = asked.result()
            waiting[index + 1] = reader.submit(batches.sequence, index + 1)
            return clip

        yield draw
