"""Per-pixel kernels (kernel prediction): filter an image without unfolding it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

__all__ = ["apply_kernels"]


def apply_kernels(
    kernels: Float[Tensor, "n taps h w"], image: Float[Tensor, "n c h w"]
) -> Float[Tensor, "n c h w"]:
    """Weighted sum of the k x k neighbours of each pixel, with a kernel per pixel; taps = k * k.

    Taps are in reading order, so tap k // 2 * (k + 1) is the pixel itself; k is odd. Weights are
    not normalized. Border pixels are replicated. Kernel prediction as in Bako et al. 2017,
    Kernel-Predicting Convolutional Networks for Denoising Monte Carlo Renderings, where a softmax
    normalizes the weights. Forward and backward passes need the memory of a few images, while
    unfolding needs that of k * k. Raises ValueError if taps is not the square of an odd number.

    >>> kernels = torch.full((1, 9, 4, 5), 1 / 9)  # a 3 x 3 box filter
    >>> apply_kernels(kernels, torch.rand(1, 3, 4, 5)).shape
    torch.Size([1, 3, 4, 5])
    """
    reach = _side(kernels.shape[1]) // 2
    padded = F.pad(image, (reach, reach, reach, reach), mode="replicate")
    filtered: Tensor = _ApplyKernels.apply(kernels, padded)  # type: ignore[no-untyped-call]
    return filtered


class _ApplyKernels(torch.autograd.Function):
    """Sum over taps of kernel times shifted image; the backward pass shifts the image again."""

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
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None]:
        kernels, padded = ctx.saved_tensors
        needs_kernels, needs_image = ctx.needs_input_grad
        grad_kernels = torch.empty_like(kernels) if needs_kernels else None
        grad_image = torch.zeros_like(padded) if needs_image else None
        if grad_kernels is not None:
            for tap, shifted in _shifts(padded, kernels):
                torch.sum(grad * shifted, 1, out=grad_kernels[:, tap])
        if grad_image is not None:
            for tap, shifted in _shifts(grad_image, kernels):
                shifted.addcmul_(kernels[:, tap, None], grad)
        return grad_kernels, grad_image


def _shifts(padded: Tensor, kernels: Tensor) -> Iterator[tuple[int, Tensor]]:
    """Each tap with the view of the padded image that it reads."""
    _, taps, h, w = kernels.shape
    side = _side(taps)
    for tap in range(taps):
        y, x = divmod(tap, side)
        yield tap, padded[..., y : y + h, x : x + w]


def _side(taps: int) -> int:
    side = math.isqrt(taps)
    if side * side != taps or side % 2 == 0:
        raise ValueError(
            f"the number of taps must be the square of an odd side (9, 25, 49, ...), not {taps}"
        )
    return side
