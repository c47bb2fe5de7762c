"""What a metric is: one number for each image, with all that is needed to reproduce it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

from metrics.comparison import MAX_PREVIOUS, Comparison
from metrics.ground_truth import GroundTruth

__all__ = ["Comparison", "Metric"]  # a plugin imports both from here

Tensor = Any  # torch.Tensor; the first score imports torch, so that listing metrics is fast
# of a Comparison, or of a list of them with `whole_clip`; of a convention too, with
# `takes_convention`
Score = Callable[..., Any]


@dataclass(frozen=True)
class Metric:
    """A metric: one number for each image of a batch.

    `score` takes a `Comparison` and returns [n]. Scores are finite for any image; they are NaN only
    where the metric is undefined for every image: at a size, or in a frame without motion from the
    one before. A metric that reads one or two `previous_frames` has no score of the first frames of
    a clip. The `score` of a `whole_clip` metric takes the comparisons of all frames, each with one
    image, and returns one number.

    >>> import torch
    >>> mean_error = Metric(
    ...     name="l1",
    ...     unit="",
    ...     direction="lower",
    ...     convention="linear radiance, mean of absolute differences",
    ...     score=lambda c: (c.image - c.reference).abs().mean((1, 2, 3)),
    ... )
    >>> black, white = torch.zeros(1, 3, 8, 8), torch.ones(1, 3, 8, 8)
    >>> mean_error.score(mean_error.compare(black, white, white))
    tensor([1.])
    """

    name: str
    unit: str  # "dB", or empty for a plain number
    direction: str  # "higher" or "lower" is better; empty where neither is
    convention: str  # what is needed to reproduce the number: colour space, peak, window
    score: Score
    fit: Callable[[int, int], Metric] | None = None  # (height, width) to the metric at that size
    needs_reference_halves: bool = False  # undefined unless the halves are independent
    needs_reference: bool = True  # False: a score of the image or its samples alone
    previous_frames: int = 0  # that the score reads, 0 to MAX_PREVIOUS
    scores_previous: bool = False  # of the image before, which is shown in place of this one
    requires: tuple[str, ...] = ()  # Python distributions; a new version invalidates old scores
    scored_by_run: bool = True  # False: slow, or of an optional package; for `rlbench evaluate`
    whole_clip: bool = False  # scores a list of all frames; only where `scored_by_run` is False
    # the same score from the PSNR of all frames: a run adds it to the rows of methods with a memory
    from_psnr: Callable[[Sequence[float]], float] | None = None
    needs: tuple[str, ...] = ()  # counts, max_samples, motion: no score of a frame that lacks one
    # the score is of errors of single pixels, so that it may be that of some pixels in any shape
    pixelwise: bool = False
    takes_convention: bool = False  # `score` takes `convention=`, of metrics.conventions
    source: str = ""  # author and year of the definition

    compare: ClassVar[Callable[..., Comparison]] = Comparison.of  # one image with one reference
    comparison_type: ClassVar[type[Comparison]] = Comparison  # that the benchmark makes for `score`
    ground_truth_type: ClassVar[type[GroundTruth]] = GroundTruth

    def __post_init__(self) -> None:
        """Raise ValueError for a metric that is never handed the frames that it needs."""
        if not 0 <= self.previous_frames <= MAX_PREVIOUS:
            raise ValueError(
                f"metric '{self.name}' reads previous_frames={self.previous_frames}, but a "
                f"comparison keeps 0 to {MAX_PREVIOUS}; score whole clips with whole_clip=True"
            )
        if self.whole_clip and self.scored_by_run:
            raise ValueError(
                f"metric '{self.name}' has whole_clip=True and scored_by_run=True, but a run "
                "scores frame by frame; give it scored_by_run=False"
            )

    def at(self, height: int, width: int) -> Metric:
        """The metric to use at an image size: this one, or its substitute for small images.

        A substitute has a different name, because its numbers are not comparable.

        >>> from metrics.catalog import MS_SSIM
        >>> MS_SSIM.at(1080, 1920).name, MS_SSIM.at(96, 128).name
        ('ms_ssim', 'ms_ssim_4')
        """
        return self.fit(height, width) if self.fit else self

    def under(self, name: str) -> Metric:
        """This metric under a named convention, called `psnr@hable`; for `rlbench evaluate`.

        >>> from metrics.catalog import MS_SSIM, PSNR
        >>> PSNR.under("hable").name, MS_SSIM.under("linear").at(96, 128).name
        ('psnr@hable', 'ms_ssim_4@linear')

        Raises ValueError for an unknown convention, or a metric that is defined under one alone.
        """
        from metrics.conventions import get_convention

        convention = get_convention(name)
        if not self.takes_convention:
            raise ValueError(
                f"metric '{self.name}' has one convention ({self.convention}), so it has no score "
                f"under '{name}'"
            )
        return replace(
            self,
            name=f"{self.name}@{name}",
            convention=f"{convention.sentence}; else as {self.name}",
            score=partial(self.score, convention=convention),
            fit=partial(_fit_under, self.fit, name) if self.fit else None,
            scored_by_run=False,
        )


def _fit_under(fit: Callable[[int, int], Metric], name: str, height: int, width: int) -> Metric:
    return fit(height, width).under(name)
