"""What a metric is handed: one frame beside its reference."""

from __future__ import annotations

import copy
import math
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from metrics.ground_truth import GroundTruth

if TYPE_CHECKING:
    from metrics.conventions import Convention

__all__ = ["MAX_PREVIOUS", "Comparison", "EncodedPair"]

MAX_PREVIOUS = 2  # frames before this one that a comparison keeps
Tensor = Any  # torch.Tensor; the first score imports torch, so that listing metrics is fast


class EncodedPair(NamedTuple):
    """An image and its reference as a convention shows them, [n 3 h w] in [0, 1]."""

    image: Tensor
    reference: Tensor


@dataclass(frozen=True, eq=False)
class Comparison:
    """An image beside its reference, and what metrics derive from both, each computed once.

    `image` is [n 3 h w] in linear radiance, where 1.0 is display white; `truth` holds what depends
    on the reference alone. `previous` is the frame before, with what it computed; of a chain of
    frames MAX_PREVIOUS are kept before this one, and older ones forgotten.

    >>> import torch
    >>> black, white = torch.zeros(1, 3, 8, 8), torch.ones(1, 3, 8, 8)
    >>> truth = GroundTruth(black, white)
    >>> first = Comparison(black, truth)
    >>> first.reference.mean(), first.display_reference.mean()
    (tensor(0.5000), tensor(0.7354))
    >>> third = Comparison(black, truth, previous=Comparison(black, truth, previous=first))
    >>> third.frames_before, Comparison(black, truth, previous=third).frames_before
    (2, 2)
    """

    image: Tensor
    truth: GroundTruth
    _: KW_ONLY
    counts: Tensor | None = None  # [n 1 h w] samples drawn; None where they are not known
    max_samples: int | None = None  # most samples that one pixel can have; None: not known
    previous: Comparison | None = field(default=None, repr=False)

    _encoded: dict[str, EncodedPair] = field(default_factory=dict, init=False, repr=False)
    _similar: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def of(
        cls,
        image: Tensor,
        half_a: Tensor,
        half_b: Tensor,
        *,
        motion: Tensor | None = None,
        static: bool = False,
        counts: Tensor | None = None,
        max_samples: int | None = None,
        previous: Comparison | None = None,
    ) -> Comparison:
        """An image beside a reference that it shares with no other image."""
        truth = GroundTruth(half_a, half_b, motion, static)
        return cls(image, truth, counts=counts, max_samples=max_samples, previous=previous)

    def __post_init__(self) -> None:
        """Forget frames that are too old. Raises TypeError for a reference in place of `truth`."""
        if not isinstance(self.truth, GroundTruth):
            raise TypeError(
                f"a Comparison takes an image and a GroundTruth, got {type(self.truth).__name__}; "
                "of an image and two halves, Comparison.of(image, half_a, half_b) makes one"
            )
        if self.previous is not None:
            object.__setattr__(self, "previous", self.previous._keep_before(MAX_PREVIOUS - 1))

    @property
    def frames_before(self) -> int:
        """Number of frames before this one that are known, 0 to MAX_PREVIOUS."""
        return 0 if self.previous is None else 1 + self.previous.frames_before

    @property
    def half_a(self) -> Tensor:
        """One half of the reference, [n 3 h w] in linear radiance."""
        return self.truth.half_a

    @property
    def half_b(self) -> Tensor:
        """The other, independent half of the reference, [n 3 h w] in linear radiance."""
        return self.truth.half_b

    @property
    def reference(self) -> Tensor:
        """The mean of both halves, [n 3 h w] in linear radiance."""
        return self.truth.mean

    @property
    def motion(self) -> Tensor | None:
        """Pixels to the previous frame, [n 2 h w]; None if the frame is static, or not known."""
        return self.truth.motion

    @property
    def static(self) -> bool:
        """True if nothing moves from the previous frame to this one."""
        return self.truth.static

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
            image, reference = convention.encode(self.image), self.truth.encode(convention)
            if self.has_nonfinite:
                worst = (reference < 0.5).to(reference.dtype)
                image = image.where(~self.nonfinite_mask, worst)
            self._encoded[convention.name] = EncodedPair(image, reference)
        return self._encoded[convention.name]

    @cached_property
    def nonfinite_mask(self) -> Tensor:
        """[n 1 h w]: True where a channel of the image's pixel is NaN or infinite."""
        from metrics.image import nonfinite_mask

        return nonfinite_mask(self.image)

    @cached_property
    def has_nonfinite(self) -> bool:
        """True if any pixel is not finite."""
        return bool(self.nonfinite_mask.any())

    @cached_property
    def linear(self) -> EncodedPair:
        """Image and reference in linear radiance, [n 3 h w] as `bound_radiance` returns them."""
        from metrics.image import bound_radiance

        mask = self.nonfinite_mask if self.has_nonfinite else None
        return EncodedPair(bound_radiance(self.image, mask), self.truth.bounded_mean)

    @cached_property
    def count_ranks(self) -> Tensor:
        """Ranks of the pixels by their `counts`, which must be known, [n pixels]."""
        from metrics.effort import centre_ranks

        counts: Any = self.counts
        return centre_ranks(counts)

    def similarity(self, convention: Convention | None = None) -> Any:
        """What SSIM and MS-SSIM share under a convention, a `metrics.ssim.SimilarityTerms`."""
        from metrics.conventions import SRGB
        from metrics.ssim import similarity_terms

        name = (convention or SRGB).name
        if name not in self._similar:
            finest = self.truth.windows(convention)[0]
            self._similar[name] = similarity_terms(self.encode(convention).image, finest)
        return self._similar[name]

    @cached_property
    def display_error(self) -> Tensor:
        """Image minus reference in clipped sRGB, [n 3 h w]; NaN in pixels that are not finite."""
        error = self.display_image - self.display_reference
        return error.masked_fill(self.nonfinite_mask, math.nan) if self.has_nonfinite else error

    @cached_property
    def change_of_error(self) -> Any:
        """How the display error changed along the motion, a `metrics.temporal.ErrorChange`.

        There must be a `previous` frame, and motion must be known.
        """
        from metrics.temporal import change_of_error

        previous: Any = self.previous
        return change_of_error(
            self.display_error, previous.display_error, self.truth.previous_positions
        )

    def has(self, name: str) -> bool:
        """True if `counts`, `max_samples` or `motion` is known; a static frame's motion is 0."""
        return getattr(self, name) is not None or (name == "motion" and self.static)

    def has_references(self, frames_before: int) -> bool:
        """True if this frame has a reference, and those of the `frames_before` it that are kept."""
        previous = self.previous if frames_before else None
        rest = previous is None or previous.has_references(frames_before - 1)
        return self.truth.has_reference and rest

    def _keep_before(self, count: int) -> Comparison:
        """This frame and all that it computed, with at most `count` frames before it."""
        if self.previous is None or self.frames_before <= count:
            return self
        frame = copy.copy(self)  # with the same cached images
        previous = self.previous._keep_before(count - 1) if count else None
        object.__setattr__(frame, "previous", previous)
        return frame
