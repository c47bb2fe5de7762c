"""A long run in figures per frame, without its images."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.stress.display import psnr
from rlbench.checks.stress.long_clip import STATIC, long_clip
from rlbench.checks.stress.section import StressedMethod
from rlbench.checks.stress.state_size import largest_value, live_tensor_bytes, state_bytes
from rlbench.frames import GBuffer, Samples
from rlbench.method import Method, State
from rlbench.run import FrameResult, run_clip
from rlbench.wrappers import MethodWrapper

__all__ = ["LongRun", "record_run"]

STATE_STEP = 10  # frames between two looks at the values of the state


@dataclass(frozen=True)
class LongRun:
    """Figures of a long run; window `early` begins at a fifth of its length, `last` ends the run.

    Bytes are those at the first frame of `early` and after the last frame.
    """

    described: str  # what was run
    early: slice  # frames
    last: slice  # frames
    psnr: Float[Tensor, "frames n"]
    sample_psnr: Float[Tensor, "frames n"]  # of the mean of each frame's samples
    mean_psnr: Float[Tensor, " frames"]  # of the mean of all samples so far, static clip
    state_bytes: tuple[int, int]
    live_bytes: tuple[int, int]
    largest_value: float  # absolute, of the state


@dataclass
class _RunningMean:
    """The mean of all samples of the static clip."""

    total: Tensor | float = 0.0
    count: Tensor | float = 0.0

    def add(self, samples: Samples) -> Tensor:
        """The mean [1 3 h w] with the samples of one more frame; each has equal weight."""
        self.total = self.total + samples.radiance[STATIC : STATIC + 1].sum(1)
        self.count = self.count + samples.counts[STATIC : STATIC + 1]
        assert isinstance(self.count, Tensor)
        return self.total / self.count.clamp_min(1)


@dataclass(frozen=True)
class _StateObserver(MethodWrapper[Method]):
    """The wrapped method, and a list that holds the state that it returned last."""

    last_state: list[State] = field(default_factory=list)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The wrapped method's image and state."""
        image, state = super().denoise(gbuffer, samples, state)
        self.last_state[:] = [state]
        return image, state


def record_run(stressed_method: StressedMethod, frames: int, window: int) -> LongRun:
    """Run a method over a long clip, static and moving in one batch.

    `window` is the number of frames of the windows `early` and `last`.
    """
    clip = long_clip(frames, stressed_method.device)
    early = slice(min(20, frames // 4), min(20, frames // 4) + window)
    observer, running_mean = _StateObserver(stressed_method.method), _RunningMean()
    scores, bytes_at, largest = [], {}, 0.0
    for result in run_clip(observer, clip, stressed_method.default_spp):
        index = result.frame.index
        scores.append(_score(result, running_mean))
        if index in (early.start, frames - 1):
            bytes_at[index] = state_bytes(observer.last_state[0]), live_tensor_bytes()
        if index % STATE_STEP == 0 or index == frames - 1:
            largest = max(largest_value(observer.last_state[0]), largest, key=_nan_last)
    (state_before, live_before), (state_after, live_after) = bytes_at.values()
    image, sample, mean = (torch.tensor(column) for column in zip(*scores, strict=True))
    return LongRun(
        f"{frames} frames of {clip.size.w}x{clip.size.h} at {stressed_method.default_spp:g} spp",
        early,
        slice(frames - window, frames),
        image,
        sample,
        mean[:, 0],
        (state_before, state_after),
        (live_before, live_after),
        largest,
    )


def _score(result: FrameResult, running_mean: _RunningMean) -> tuple[list[float], ...]:
    """PSNR of the image, of the frame's samples, and of the mean of all samples so far."""
    reference = result.frame.reference.mean
    static = reference[STATIC : STATIC + 1]
    pairs = (
        (result.image, reference),
        (result.samples.mean, reference),
        (running_mean.add(result.samples), static),
    )
    return tuple(psnr(image, truth).tolist() for image, truth in pairs)


def _nan_last(value: float) -> float:
    return float("inf") if value != value else value
