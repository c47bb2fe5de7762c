"""The largest error of any pixel."""

from __future__ import annotations

from metrics.metric import Comparison, Metric, Tensor

MAX_ERROR = 6e4  # of a pixel that is not finite, so that every score is finite


def worst_pixel(frame: Comparison) -> Tensor:
    """[n]: the largest absolute difference to the reference, in linear radiance."""
    difference = (frame.image - frame.reference).abs().nan_to_num(MAX_ERROR, MAX_ERROR)
    return difference.clamp_max(MAX_ERROR).flatten(1).amax(1)


WORST_PIXEL = Metric(
    name="${name}_worst_pixel",
    unit="",
    direction="lower",
    convention="largest absolute error, linear radiance, 1.0 = display white",
    score=worst_pixel,
)
