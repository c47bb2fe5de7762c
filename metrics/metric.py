"""What a metric is, and what it is handed: one frame beside its reference."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

if TYPE_CHECKING:
    from metrics.conventions import Convention

__all__ = ["Comparison", "Metric", "EncodedPair"]

Tensor = Any  # torch.Tensor; the first score imports torch, so that listing metrics is fast


class EncodedPair(NamedTuple):
    """An image and its reference as a convention shows them, [n 3 h w] in [0, 1]."""

    image: Tensor
    reference: Tensor


@dataclass(frozen=True, eq=False)
class Comparison:
    """An image beside its reference, and what metrics derive from both, each computed once.

    `image` and the two independent halves of the reference are [n 3 h w] in linear radiance, where
    1.0 is display white. The halves must be finite. `previous` is the frame before; it keeps its
    images but forgets its own `previous`, so that a chain of frames needs the memory of two.

    >>> import torch
    >>> black, white = torch.zeros(1, 3, 8, 8), torch.ones(1, 3, 8, 8)
    >>> first = Comparison(black, black, white)
    >>> first.reference.mean(), first.display_reference.mean()
    (tensor(0.5000), tensor(0.7354))
    >>> second = Comparison(black, black, white, previous=first)
    >>> third = Comparison(black, black, white, previous=second)
    >>> third.previous.previous is None
    True
    """

    image: Tensor
    half_a: Tensor
    half_b: Tensor
    counts: Tensor | None = None  # [n 1 h w] samples drawn; None where they are not known
    motion: Tensor | None = None  # [n 2 h w] pixels to the previous frame; None if static, unknown
    static: bool = False  # nothing moves from the previous frame to this one
    previous: Comparison | None = field(default=None, repr=False)

    _encoded: dict[str, EncodedPair] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Keep of the previous frame what it computed, but not the frame before it."""
        if self.previous is not None and self.previous.previous is not None:
            before = copy.copy(self.previous)  # with the same cached images
            object.__setattr__(before, "previous", None)
            object.__setattr__(self, "previous", before)

    @cached_property
    def reference(self) -> Tensor:
        """The mean of both halves, [n 3 h w] in linear radiance."""
        return (self.half_a + self.half_b) / 2

    @property
    def display_image(self) -> Tensor:
        """The image in clipped sRGB, [n 3 h w] in [0, 1], without a NaN (see `encode`)."""
        return self.encode().image

    @property
    def display_reference(self) -> Tensor:
        """The reference in clipped sRGB, [n 3 h w] in [0, 1]."""
        return self.encode().reference

    def encode(self, convention: Convention | None = None) -> EncodedPair:
        """Image and reference under a convention of `metrics.conventions`, by default clipped sRGB.

        A pixel that is not finite has the largest error that a display can show: in each channel
        0 or 1, whichever is further from the reference.
        """
        from metrics.conventions import SRGB

        convention = convention or SRGB
        if convention.name not in self._encoded:
            reference = convention.encode(self.reference)
            worst = (reference < 0.5).to(reference.dtype)
            image = convention.encode(self.image).where(~self.nonfinite_mask, worst)
            self._encoded[convention.name] = EncodedPair(image, reference)
        return self._encoded[convention.name]

    @cached_property
    def nonfinite_mask(self) -> Tensor:
        """[n 1 h w]: True where a channel of the image's pixel is NaN or infinite."""
        return ~self.image.isfinite().all(1, keepdim=True)

    def has(self, name: str) -> bool:
        """True if `counts` or `motion` is known; that of a static frame is known to be 0."""
        return getattr(self, name) is not None or (name == "motion" and self.static)


Score = Callable[..., Tensor]  # of a Comparison; of a convention too, with `takes_convention`
ClipScore = Callable[[list[Comparison]], float]


@dataclass(frozen=True)
class Metric:
    """A metric: one number for each image of a batch.

    `score` takes a `Comparison` and returns [n]. Scores are finite for any image; they are NaN only
    at a size for which the metric is undefined. A `temporal` metric also reads `previous`; the
    first frame of a clip has no score. The `score` of a `whole_clip` metric takes the comparisons
    of all frames, each with one image, and returns one number.

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
    direction: str  # "higher" or "lower" is better; empty for a signed error, best at zero
    convention: str  # what is needed to reproduce the number: colour space, peak, window
    score: Score | ClipScore
    fit: Callable[[int, int], Metric] | None = None  # (height, width) to the metric at that size
    needs_reference_halves: bool = False  # undefined unless the halves are independent
    temporal: bool = False  # compares the change from the previous frame
    requires: tuple[str, ...] = ()  # Python distributions; a new version invalidates old scores
    scored_by_run: bool = True  # False: slow, or of an optional package; for `rlbench evaluate`
    whole_clip: bool = False  # scores a list of all frames; only where `scored_by_run` is False
    needs: tuple[str, ...] = ()  # of "counts" and "motion": no score of a frame that lacks one
    takes_convention: bool = False  # `score` takes `convention=`, of metrics.conventions
    source: str = ""  # author and year of the definition

    compare: ClassVar[type[Comparison]] = Comparison  # what the benchmark hands to `score`

    def __post_init__(self) -> None:
        """Raise ValueError for a metric of whole clips that a run would hand single frames."""
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
        from metrics.conventions import convention_named

        convention = convention_named(name)
        if not self.takes_convention:
            raise ValueError(
                f"metric '{self.name}' has one convention ({self.convention}), so it has no score "
                f"under '{name}'"
            )
        return replace(
            self,
            name=f"{self.name}@{name}",
            convention=f"{convention.sentence}; else as {self.name}",
            score=partial(self.score, convention=convention),  # type: ignore[call-arg]
            fit=partial(_fit_under, self.fit, name) if self.fit else None,
            scored_by_run=False,
        )


def _fit_under(fit: Callable[[int, int], Metric], name: str, height: int, width: int) -> Metric:
    return fit(height, width).under(name)
