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

from rlbench.clips.stored import ALL, MemoryClip, open_clip
from rlbench.family import Traits
from rlbench.frames import Frame, Reference, StoredPool, View
from rlbench.training.config import Plan


class BatchError(ValueError):
    """Clips of which no batch can be cut."""


@dataclass(frozen=True)
class Augmentation:
    """How a crop is turned. Drawn once a sequence and kept over its frames."""

    mirror: bool  # left to right
    flip: bool  # top to bottom
    transpose: bool  # rows become columns
    gain: float  # exposure, factor on radiance
    colours: tuple[int, ...]  # the order of red, green and blue, in radiance and albedo

    def turn(self, image: Tensor) -> Tensor:
        """An image [... h w], mirrored, flipped and transposed."""
        axes = [axis for axis, wanted in ((-1, self.mirror), (-2, self.flip)) if wanted]
        image = image.flip(axes) if axes else image
        return image.transpose(-1, -2) if self.transpose else image

    def tint(self, image: Tensor) -> Tensor:
        """Radiance or albedo [... 3 h w], turned, with its colours in another order."""
        return self.turn(image)[..., list(self.colours), :, :]

    def turn_motion(self, motion: Tensor) -> Tensor:
        """The same for motion [n 2 h w], whose vectors turn with the image."""
        sign = motion.new_tensor([-1.0 if self.mirror else 1.0, -1.0 if self.flip else 1.0])
        motion = self.turn(motion) * sign.view(1, 2, 1, 1)
        return motion.flip(1) if self.transpose else motion

    def apply(self, frame: Frame) -> Frame:
        """The frame, turned and exposed; a static view gets motion zero, so that clips can mix."""
        view = frame.view
        motion = view.motion if view.motion is not None else torch.zeros_like(view.normal[:, :2])
        kept = {k: v for k, v in view.buffers.items() if k != "motion"}
        buffers = {k: (self.tint if "albedo" in k else self.turn)(v) for k, v in kept.items()}
        buffers |= {"motion": self.turn_motion(motion)}
        pool = frame.pool
        assert isinstance(pool, StoredPool)
        return Frame(
            frame.index,
            View(buffers),
            StoredPool(self.tint(pool.radiance) * self.gain, pool.keys),
            Reference(
                self.tint(frame.reference.a) * self.gain, self.tint(frame.reference.b) * self.gain
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
    needs: frozenset[str] = ALL  # view buffers, beside those that are turned in a way of their own

    @classmethod
    def planned(cls, folders: Sequence[Path], plan: Plan, traits: Traits, device: str) -> Batches:
        """As a plan has them, for a method of those traits."""
        how = (plan.batch, plan.crop, plan.length, plan.seed)
        return cls(folders, *how, device, traits.pool, traits.needs)

    def __post_init__(self) -> None:
        """Refuse to draw from nothing."""
        if not self.folders:
            raise BatchError("no clips to train on; 'rlbench render --preset train' makes some")

    def contents(self) -> list[str]:
        """Name and hash of each clip, as cards and checkpoints tell what was trained on."""
        opened = [open_clip(folder, pool=self.pool) for folder in self.folders]
        return [f"{clip.name} {clip.digest[:12]}" for clip in opened]

    def draw(self, index: int) -> MemoryClip:
        """A clip of `batch` crops side by side, `length` frames long or as long as the shortest."""
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + index)
        parts = [self._part(generator) for _ in range(self.batch)]
        frames = [_stack(together) for together in zip(*parts, strict=False)]
        return MemoryClip(f"draw {index}", "training", "", frames)

    def _part(self, generator: torch.Generator) -> list[Frame]:
        folder = self.folders[_integer(generator, len(self.folders))]
        order = _integer(generator, 2**31)
        needs = self.needs | {"albedo", "normal", "motion"}
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


def one_of(budgets: Sequence[float], seed: int, draw: int) -> float:
    """The budget, in samples per pixel, of one draw of a training with that seed.

    It is drawn apart from the clip: were both from one generator, some scenes would never be seen
    at some budgets.
    """
    told = hashlib.blake2b(f"{seed}/{draw}/budget".encode(), digest_size=8).digest()
    return budgets[int.from_bytes(told) % len(budgets)]


def _stack(frames: Sequence[Frame]) -> Frame:
    names = frames[0].view.buffers
    pools = [frame.pool for frame in frames]
    view = View({k: torch.cat([f.view.buffers[k] for f in frames]) for k in names})
    radiance = torch.cat([p.radiance for p in pools if isinstance(p, StoredPool)])
    keys = tuple(key for pool in pools for key in pool.keys)
    a = torch.cat([f.reference.a for f in frames])
    b = torch.cat([f.reference.b for f in frames])
    return Frame(frames[0].index, view, StoredPool(radiance, keys), Reference(a, b))


def _integer(generator: torch.Generator, below: int) -> int:
    return int(torch.randint(below, (), generator=generator))


@contextmanager
def ahead(batches: Batches) -> Iterator[Callable[[int], MemoryClip]]:
    """`Batches.draw`, one draw ahead of what is asked for, in a thread of its own.

    The draws are the same as without. What stops the reading of a draw is raised when that draw is
    asked for.
    """
    waiting: dict[int, Future[MemoryClip]] = {}
    with ThreadPoolExecutor(1, thread_name_prefix="draw") as reader:

        def draw(index: int) -> MemoryClip:
            asked = waiting.pop(index, None) or reader.submit(batches.draw, index)
            waiting.clear()
            clip = asked.result()
            waiting[index + 1] = reader.submit(batches.draw, index + 1)
            return clip

        yield draw
