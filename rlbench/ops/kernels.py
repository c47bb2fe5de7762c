"""Per-pixel kernels (kernel prediction): gather or splat an image without unfolding it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.asking import is_compiling

__all__ = ["apply_kernels", "splat_kernels"]


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
    side = math.isqrt(kernels.shape[1])
    if side * side != kernels.shape[1] or side % 2 == 0:
        raise ValueError(
            "the number of taps must be the square of an odd side (9, 25, 49, ...), not "
            f"{kernels.shape[1]}"
        )
    reach = side // 2
    padded = F.pad(image, (reach, reach, reach, reach), mode="replicate")
    filtered: Tensor = _ApplyKernels.apply(kernels, padded)  # type: ignore[no-untyped-call]
    return filtered


def splat_kernels(
    kernels: Float[Tensor, "n taps h w"], image: Float[Tensor, "n c h w"], stride: int = 1
) -> Float[Tensor, "n c h2 w2"]:
    """Each pixel's value, spread over k x k pixels with a kernel of its own; taps = k * k.

    The transpose of `apply_kernels`: a kernel belongs to the pixel that light comes from, not to
    the one that it reaches. A `stride` of s upsamples: the output is s times as large, and source
    pixel i covers the k outputs from s i - (k - s) / 2 on, along each axis. Taps are in reading
    order. Taps beyond the border are mirrored back, so kernels that sum to one preserve the sum of
    the image. Raises ValueError if taps is not k * k with k = s, s + 2, s + 4, ..., or if the
    output is smaller than (k - s) / 2.

    >>> kernels = torch.full((1, 16, 4, 5), 1 / 16)  # 4 x 4 taps; 4/16 of each value per output
    >>> splat_kernels(kernels, torch.ones(1, 3, 4, 5), stride=2).unique()
    tensor([0.2500])
    """
    taps, (h, w) = kernels.shape[1], image.shape[-2:]
    side = math.isqrt(taps)
    reach = (side - stride) // 2
    if side * side != taps or reach < 0 or (side - stride) % 2:
        raise ValueError(
            f"at stride {stride} the number of taps must be the square of {stride}, {stride + 2}, "
            f"{stride + 4}, ..., not {taps}"
        )
    if reach > stride * min(h, w):
        raise ValueError(
            f"kernels of {side} x {side} taps reach {reach} pixels beyond the border, more than "
            f"the {stride * h} x {stride * w} pixels of the output; pad the image"
        )
    canvas: Tensor = _SplatKernels.apply(kernels, image, stride)  # type: ignore[no-untyped-call]
    return _mirror_border(_mirror_border(canvas, reach, 2), reach, 3)


class _ApplyKernels(torch.autograd.Function):
    """Sum over taps of kernel times shifted image; the backward pass shifts the image again."""

    @staticmethod
    def forward(ctx: Any, kernels: Tensor, padded: Tensor) -> Tensor:
        ctx.save_for_backward(kernels, padded)
        return _gather(kernels, padded)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None]:
        kernels, padded = ctx.saved_tensors
        needs_kernels, needs_image = ctx.needs_input_grad
        grad_kernels = _kernel_gradient(kernels, grad, padded) if needs_kernels else None
        grad_image = _scatter(kernels, grad, torch.zeros_like(padded)) if needs_image else None
        return grad_kernels, grad_image


class _SplatKernels(torch.autograd.Function):
    """The transpose of `_ApplyKernels`, onto a canvas with a border for what reaches outside."""

    @staticmethod
    def forward(ctx: Any, kernels: Tensor, image: Tensor, stride: int) -> Tensor:
        ctx.save_for_backward(kernels, image)
        ctx.stride = stride
        n, c, h, w = image.shape
        border = math.isqrt(kernels.shape[1]) - stride
        canvas = image.new_zeros(n, c, stride * h + border, stride * w + border)
        return _scatter(kernels, image, canvas, stride)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        kernels, image = ctx.saved_tensors
        needs_kernels, needs_image, _ = ctx.needs_input_grad
        grad_kernels = _kernel_gradient(kernels, image, grad, ctx.stride) if needs_kernels else None
        grad_image = _gather(kernels, grad, ctx.stride) if needs_image else None
        return grad_kernels, grad_image, None


def _gather(kernels: Tensor, padded: Tensor, stride: int = 1) -> Tensor:
    """Sum over taps of the kernel times the shifted image."""
    n, _, h, w = kernels.shape
    if _prefers_few_steps(padded) or is_compiling():
        return (kernels[:, None] * _windows(padded, kernels, stride)).sum(2)
    total = padded.new_zeros(n, padded.shape[1], h, w)
    for tap, shifted in _shifts(padded, kernels, stride):
        total.addcmul_(kernels[:, tap, None], shifted)
    return total


def _scatter(kernels: Tensor, image: Tensor, canvas: Tensor, stride: int = 1) -> Tensor:
    """The canvas and, shifted, kernel times image; on a CPU added in place, tap by tap."""
    if _prefers_few_steps(image):
        spread = (kernels[:, None] * image[:, :, None]).flatten(1, 2).flatten(2)
        side = math.isqrt(kernels.shape[1])
        return canvas + F.fold(spread, canvas.shape[-2:], side, stride=stride)
    for tap, shifted in _shifts(canvas, kernels, stride):
        shifted.addcmul_(kernels[:, tap, None], image)
    return canvas


def _kernel_gradient(kernels: Tensor, image: Tensor, padded: Tensor, stride: int = 1) -> Tensor:
    """For each tap the product of the image and the shifted padded image, summed over channels."""
    if _prefers_few_steps(image):
        return (image[:, :, None] * _windows(padded, kernels, stride)).sum(1)
    gradient = torch.empty_like(kernels)
    for tap, shifted in _shifts(padded, kernels, stride):
        torch.sum(image * shifted, 1, out=gradient[:, tap])
    return gradient


def _prefers_few_steps(image: Tensor) -> bool:
    """Whether all taps go at once, in much memory: a step costs a GPU more than its arithmetic."""
    return image.is_cuda


def _windows(padded: Tensor, kernels: Tensor, stride: int) -> Float[Tensor, "n c taps h w"]:
    """The view of the padded image that each tap reads."""
    _, taps, h, w = kernels.shape
    side = math.isqrt(taps)
    windows = padded.unfold(2, side, stride).unfold(3, side, stride)[:, :, :h, :w]
    return windows.permute(0, 1, 4, 5, 2, 3).flatten(2, 3)


def _shifts(padded: Tensor, kernels: Tensor, stride: int) -> Iterator[tuple[int, Tensor]]:
    """Each tap with the view of the padded image that it reads or writes."""
    _, taps, h, w = kernels.shape
    side = math.isqrt(taps)
    for tap in range(taps):
        y, x = divmod(tap, side)
        yield tap, padded[..., y : y + stride * h : stride, x : x + stride * w : stride]


def _mirror_border(canvas: Tensor, reach: int, dim: int) -> Tensor:
    """The canvas without `reach` pixels at both ends of an axis, whose values are mirrored back."""
    size = canvas.shape[dim] - 2 * reach
    before, inside, after = canvas.split_with_sizes((reach, size, reach), dim)
    folded = inside.clone()
    folded.narrow(dim, 0, reach).add_(before.flip(dim))
    folded.narrow(dim, size - reach, reach).add_(after.flip(dim))
    return folded
