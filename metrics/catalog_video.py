"""The shipped metrics of motion, and of where samples went."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from metrics.metric import Comparison, Metric

__all__ = [
    "AT_CAP",
    "DRIFT",
    "EFFORT_ERROR",
    "EFFORT_NOISE",
    "FLICKER",
    "IMAGE_FLICKER",
    "PSNR_LATE",
    "WARPED_ERROR",
]

Tensor = Any  # torch.Tensor; the first score imports torch, so that listing metrics is fast


def _warped_error(frame: Comparison) -> Tensor:
    from metrics.temporal import warped_error

    return warped_error(frame.change_of_error)


def _flicker(frame: Comparison) -> Tensor:
    from metrics.temporal import flicker

    previous: Any = frame.previous
    return flicker(frame.change_of_error, previous.change_of_error)


def _image_flicker(frame: Comparison) -> Tensor:
    from metrics.temporal import change_of_error, flicker

    def step(newer: Any) -> Any:
        image, previous = (
            each.display_image.masked_fill(each.nonfinite_mask, float("nan"))
            for each in (newer, newer.previous)
        )
        return change_of_error(image, previous, newer.truth.previous_positions)

    return flicker(step(frame), step(frame.previous))


def _psnr_late(frame: Comparison) -> Tensor:
    from metrics.psnr import psnr

    previous: Any = frame.previous
    return psnr(previous.display_image, frame.display_reference, previous.nonfinite_mask)


def drift(scores: Sequence[float]) -> float:
    """Mean of the last quarter of a clip's scores less that of the first quarter, in their unit.

    A quarter has at least one frame. NaN where a frame in either has no score. A memory that
    gathers errors has a drift below 0; one that warms up, above.

    >>> drift([20.0, 24.0, 24.0, 24.0, 24.0, 23.0, 23.0, 23.0])
    1.0
    """
    quarter = max(1, len(scores) // 4)
    return (sum(scores[-quarter:]) - sum(scores[:quarter])) / quarter


def _drift(frames: Sequence[Comparison]) -> float:
    from metrics.psnr import psnr

    return drift(
        [
            float(psnr(each.display_image, each.display_reference, each.nonfinite_mask)[0])
            for each in frames
        ]
    )


def _effort_error(frame: Comparison) -> Tensor:
    from metrics.effort import effort_error

    return effort_error(frame.count_ranks, frame.display_error)


def _effort_noise(frame: Comparison) -> Tensor:
    from metrics.effort import correlate_ranks

    return correlate_ranks(frame.count_ranks, frame.truth.noise_ranks)


def _at_cap(frame: Comparison) -> Tensor:
    from metrics.effort import at_cap

    counts: Any = frame.counts
    max_samples: Any = frame.max_samples
    return at_cap(counts, max_samples)


PSNR_LATE = Metric(
    "psnr_late",
    "dB",
    "higher",
    "PSNR of the image of the frame before, shown again because this frame is late; peak 1, "
    "clipped sRGB",
    _psnr_late,
    previous_frames=1,
    scores_previous=True,
    pixelwise=True,
    source="this project: what a missed deadline costs",
)
DRIFT = Metric(
    "drift",
    "dB",
    "higher",
    "PSNR of the last quarter of a clip's frames less that of the first; peak 1, clipped sRGB",
    _drift,
    scored_by_run=False,
    whole_clip=True,
    from_psnr=drift,
    pixelwise=True,
    source="this project: does the memory gather errors?",
)
WARPED_ERROR = Metric(
    "warped_error",
    "%",
    "lower",
    "RMS of the image's change along the motion less the reference's, of the range of clipped "
    "sRGB; none where all motion leaves the image",
    _warped_error,
    previous_frames=1,
    needs=("motion",),
    source="Lai et al. 2018, relative to the reference's own change",
)
FLICKER = Metric(
    "flicker",
    "%",
    "lower",
    "RMS of the error's second difference along the motion / sqrt(6), of the range of clipped "
    "sRGB; none where all motion leaves the image",
    _flicker,
    previous_frames=2,
    needs=("motion",),
    source="second difference in time; definition ours",
)
IMAGE_FLICKER = Metric(
    "image_flicker",
    "%",
    "lower",
    "RMS of the image's second difference along the motion / sqrt(6), of the range of clipped "
    "sRGB, without a reference; none where all motion leaves the image",
    _image_flicker,
    needs_reference=False,
    previous_frames=2,
    scored_by_run=False,
    needs=("motion",),
    source="second difference in time; definition ours",
)
EFFORT_ERROR = Metric(
    "effort_error",
    "",
    "",
    "Spearman correlation of sample counts with the squared error of clipped sRGB; 0 for equal "
    "counts",
    _effort_error,
    needs=("counts",),
    source="Spearman 1904",
)
EFFORT_NOISE = Metric(
    "effort_noise",
    "",
    "",
    "Spearman correlation of sample counts with the squared difference of the reference halves in "
    "clipped sRGB, over 7x7 pixels; 0 for equal counts",
    _effort_noise,
    needs_reference_halves=True,
    needs=("counts",),
    source="Spearman 1904",
)
AT_CAP = Metric(
    "at_cap",
    "%",
    "",
    "pixels with as many samples as the clip has, or as the method allows",
    _at_cap,
    needs_reference=False,
    needs=("counts", "max_samples"),
    source="Scardigli et al. 2023",
)
