"""Filtering with a kernel of its own at every pixel, without unfolding the image."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F


def apply_kernels(
    kernels: Float[Tensor, "n taps h w"], image: Float[Tensor, "n c h w"]
) -> Float[Tensor, "n c h w"]:
    """Each pixel as the weighted sum of its k x k neighbours, k odd and taps = k * k.

    Taps lie in reading order, so tap k // 2 * (k + 1) is the pixel itself. Weights are used as
    they are: nothing is normalised. Beyond the border the image repeats its edge. Needs the memory
    of a few images, forward as well as backward, where unfolding needs that of `taps` images.
    Raises ValueError if taps is not the square of an odd number.
    """
    reach = _side(kernels.shape[1]) // 2
    padded = F.pad(image, (reach, reach, reach, reach), mode="replicate")
    gathered: Tensor = _Gather.apply(kernels, padded)  # type: ignore[no-untyped-call]
    return gathered


class _Gather(torch.autograd.Function):
    """Sum over taps of kernel times shifted image; the backward pass shifts again."""

    @staticmethod
    def forward(ctx: Any, kernels: Tensor, padded: Tensor) -> Tensor:
        ctx.save_for_backward(kernels, padded)
        n, _, h, w = kernels.shape
        total = padded.new_zeros(n, padded.shape[1], h, w)
        for tap, shifted in _shifts(padded, kernels):
            total.addcmul_(kernels[:, tap, None], shifted)
        return total

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, Tensor | None]:
        kernels, padded = ctx.saved_tensors
        to_kernels, to_image = ctx.needs_input_grad
        by_kernel = torch.empty_like(kernels) if to_kernels else None
        by_image = torch.zeros_like(padded) if to_image else None
        if by_kernel is not None:
            for tap, shifted in _shifts(padded, kernels):
                torch.sum(slope * shifted, 1, out=by_kernel[:, tap])
        if by_image is not None:
            for tap, shifted in _shifts(by_image, kernels):
                shifted.addcmul_(kernels[:, tap, None], slope)
        return by_kernel, by_image


def _shifts(padded: Tensor, kernels: Tensor) -> Iterator[tuple[int, Tensor]]:
    """Each tap and the part of the padded image, a view, that it falls on."""
    _, taps, h, w = kernels.shape
    side = _side(taps)
    for tap in range(taps):
        y, x = divmod(tap, side)
        yield tap, padded[..., y : y + h, x : x + w]


def _side(taps: int) -> int:
    side = math.isqrt(taps)
    if side * side != taps or side % 2 == 0:
        raise ValueError(f"a kernel has an odd side squared of taps (9, 25, 49), not {taps}")
    return side
