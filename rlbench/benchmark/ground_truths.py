"""Ground truth of a clip's frames: what metrics derive from it serves all rows and budgets."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from rlbench.frames import Clip, Frame
from rlbench.ops.sanitize import sanitize_motion

__all__ = ["KeptGroundTruths", "ground_truth"]

MAX_PIXELS = 2**21  # of all frames of a clip that is kept: about 0.3 GB


def ground_truth(metric: Any, frame: Frame) -> Any:
    """The `metrics.ground_truth.GroundTruth` of a frame, by any `metrics.metric.Metric`."""
    buffers, static = frame.gbuffer.buffers, frame.gbuffer.static
    motion = sanitize_motion(buffers["motion"]) if "motion" in buffers and not static else None
    return metric.truth(frame.reference.half_a, frame.reference.half_b, motion, static)


class KeptGroundTruths:
    """The ground truth of one clip at a time, for as long as cells of that clip are scored.

    That of a clip with more than MAX_PIXELS pixels is not kept. A copy, as another process receives
    it, is empty.
    """

    def __init__(self, metric: Any) -> None:
        """`metric` is any `metrics.metric.Metric`."""
        self._metric, self._digest = metric, ""
        self._by_index: dict[int, Any] = {}

    def of_clip(self, clip: Clip) -> Callable[[Frame], Any]:
        """`ground_truth` of the frames of a clip; those of the clip before are forgotten."""
        if len(clip) * math.prod(clip.size) > MAX_PIXELS:
            return partial(ground_truth, self._metric)
        if clip.digest != self._digest:
            self._digest, self._by_index = clip.digest, {}
        return self._of_frame

    def __reduce__(self) -> tuple[type[KeptGroundTruths], tuple[Any]]:
        """A copy without what is kept."""
        return KeptGroundTruths, (self._metric,)

    def _of_frame(self, frame: Frame) -> Any:
        if frame.index not in self._by_index:
            self._by_index[frame.index] = ground_truth(self._metric, frame)
        return self._by_index[frame.index]
