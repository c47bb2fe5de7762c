"""The reference of a frame, and what metrics derive from it alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from metrics.conventions import Convention

__all__ = ["GroundTruth"]

Tensor = Any  # torch.Tensor; the first score imports torch, so that listing metrics is fast


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """What images of one frame are compared with; each derived image is computed once.

    The two independent halves of the reference are [n 3 h w] in linear radiance, where 1.0 is
    display white, and must be finite; those of a frame without a reference are NaN alone. The
    images of all methods and budgets are compared with one object, so its tensors must not be
    written to.

    >>> import torch
    >>> truth = GroundTruth(torch.zeros(1, 3, 8, 8), torch.ones(1, 3, 8, 8))
    >>> truth.mean.mean(), truth.encode().mean()
    (tensor(0.5000), tensor(0.7354))
    >>> truth.encode() is truth.encode()
    True
    """

    half_a: Tensor
    half_b: Tensor
    motion: Tensor | None = None  # [n 2 h w] pixels to the previous frame; None if static, unknown
    static: bool = False  # nothing moves from the previous frame to this one

    _encoded: dict[str, Tensor] = field(default_factory=dict, init=False, repr=False)
    _windows: dict[str, list[Any]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def has_reference(self) -> bool:
        """False for a frame without a reference, whose halves are NaN alone."""
        return not bool(self.half_a.flatten()[0].isnan())

    @cached_property
    def mean(self) -> Tensor:
        """The reference image: the mean of both halves, [n 3 h w] in linear radiance."""
        return (self.half_a + self.half_b) / 2

    def encode(self, convention: Convention | None = None) -> Tensor:
        """The mean under a convention of `metrics.conventions`, by default clipped sRGB."""
        from metrics.conventions import SRGB

        convention = convention or SRGB
        if convention.name not in self._encoded:
            self._encoded[convention.name] = convention.encode(self.mean)
        return self._encoded[convention.name]

    def windows(self, convention: Convention | None = None, scales: int = 1) -> list[Any]:
        """What SSIM and MS-SSIM read of the mean, a `metrics.ssim.ReferenceWindows` for each scale.

        Raises ValueError if a side is too small for `scales`.
        """
        from metrics.conventions import SRGB
        from metrics.ssim import check_scales, max_scales, reference_windows

        encoded, name = self.encode(convention), (convention or SRGB).name
        check_scales(encoded, scales)
        if name not in self._windows:
            self._windows[name] = reference_windows(encoded, max_scales(*encoded.shape[-2:]))
        return self._windows[name][:scales]

    @cached_property
    def display_halves(self) -> tuple[Tensor, Tensor]:
        """The two halves in clipped sRGB, each [n 3 h w] in [0, 1]."""
        from metrics.display import encode_display

        return encode_display(self.half_a), encode_display(self.half_b)

    @cached_property
    def display_band(self) -> Any:
        """The halves at the wavelengths of blotches, a `metrics.blotches.ReferenceBand`."""
        from metrics.blotches import reference_band

        return reference_band(*self.display_halves)

    @cached_property
    def bounded_mean(self) -> Tensor:
        """The mean in the range of half floats, [n 3 h w] as `bound_radiance` returns it."""
        from metrics.image import bound_radiance

        return bound_radiance(self.mean)

    @cached_property
    def bounded_halves(self) -> tuple[Tensor, Tensor]:
        """The two halves in the range of half floats, each [n 3 h w]."""
        from metrics.image import bound_radiance

        return bound_radiance(self.half_a), bound_radiance(self.half_b)

    @cached_property
    def noise_ranks(self) -> Tensor:
        """Ranks of the pixels by the noise of the scene, [n pixels] (`metrics.effort`)."""
        from metrics.effort import centre_ranks, scene_noise

        return centre_ranks(scene_noise(*self.display_halves))

    @cached_property
    def previous_positions(self) -> Any:
        """Where the pixels were in the frame before, `metrics.temporal.PreviousPositions`.

        Motion must be known.
        """
        from metrics.temporal import locate_previous

        return locate_previous(self.half_a, self.motion)
