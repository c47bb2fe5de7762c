"""The ground truth of a clip's frames, kept for all rows and budgets that are scored on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from rlbench.clips.wrapper import ClipWrapper
from rlbench.frames import Clip, Frame
from rlbench.ops.sanitize import sanitize_motion

__all__ = ["ClipWithTruth", "GroundTruthCache", "buffers_of_truth", "make_ground_truth"]

MAX_PIXELS = 2**21  # of all frames of a clip that is kept: about 0.3 GB


def buffers_of_truth(metrics: Iterable[Any]) -> frozenset[str]:
    """The buffers that the ground truth holds for these `metrics.metric.Metric`."""
    return frozenset({"motion"}).intersection(name for each in metrics for name in each.needs)


def make_ground_truth(metric: Any, frame: Frame) -> Any:
    """The `metrics.ground_truth.GroundTruth` of a frame, by any `metrics.metric.Metric`."""
    buffers, static = frame.gbuffer.buffers, frame.gbuffer.static
    has_motion = "motion" in buffers and not static
    motion = sanitize_motion(buffers["motion"]).clone() if has_motion else None
    reference = frame.reference
    return metric.ground_truth_type(reference.half_a, reference.half_b, motion, static)


@dataclass(frozen=True)
class ClipWithTruth(ClipWrapper):
    """A clip whose ground truth is made before a method receives the frame, and may write to it."""

    make: Callable[[Frame], Any]
    keeps_all: bool = False  # or else the present frame's alone
    _by_index: dict[int, Any] = field(default_factory=dict, repr=False)

    def __iter__(self) -> Iterator[Frame]:
        """The frames in order."""
        for frame in self.clip:
            if not self.keeps_all:
                self._by_index.clear()
            if frame.index not in self._by_index:
                self._by_index[frame.index] = self.make(frame)
            yield frame

    def ground_truth(self, frame: Frame) -> Any:
        """The ground truth of the frame that was read last, or of any if it `keeps_all`."""
        return self._by_index[frame.index]


class GroundTruthCache:
    """The ground truth of one clip at a time, for as long as cells of that clip are scored.

    That of a clip with more than MAX_PIXELS pixels is not kept. A copy, as another process receives
    it, is empty.
    """

    def __init__(self, metric: Any) -> None:
        """`metric` is any `metrics.metric.Metric`."""
        self._metric, self._digest = metric, ""
        self._by_index: dict[int, Any] = {}

    def open(self, clip: Clip) -> ClipWithTruth:
        """A clip with what is known of its ground truth; that of another clip is forgotten."""
        if clip.digest != self._digest:
            self._digest, self._by_index = clip.digest, {}
        make = partial(make_ground_truth, self._metric)
        is_small = len(clip) * math.prod(clip.size) <= MAX_PIXELS
        return (
            ClipWithTruth(clip, make, True, self._by_index)
            if is_small
            else ClipWithTruth(clip, make)
        )

    def __reduce__(self) -> tuple[type[GroundTruthCache], tuple[Any]]:
        """A copy without what is kept."""
        return GroundTruthCache, (self._metric,)
