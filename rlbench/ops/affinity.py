"""Affinity-weighted sums over neighbours with similar features, without unfolding the image."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.asking import is_compiling
from rlbench.ops.padded_rows import read_windows
from rlbench.ops.stencils import Stencil, box_stencil

__all__ = ["affinity_sum", "cross_affinity_sum"]

STRIP_PIXELS = 2**15  # pixels per strip on a CPU, so that features and sums stay in its cache
MIN_LOG_WEIGHT = -60.0  # lower bound of log weights; subnormal floats are ten times slower


def affinity_sum(
    features: Float[Tensor, "n k h w"],
    sharpness: Float[Tensor, "n 1 h w"],
    source: Float[Tensor, "n c h w"],
    side: int,
    dilation: int = 1,
) -> Float[Tensor, "n c h w"]:
    """Sum over neighbours q of pixel p of exp(-a_p |f_p - f_q|^2) source_q, without p itself.

    Features f have any range; sharpness a >= 0. Neighbours are the pixels at (p_x + i dilation,
    p_y + j dilation) with |i|, |j| <= side // 2, for an odd `side`; pixels beyond the border do not
    count. Add a channel of ones to `source` to get the sum of weights beside the weighted sums.
    Weights are at least exp(-60).

    The kernels are those of Isik et al. 2021, Interactive Monte Carlo Denoising using Affinity of
    Neural Features. Forward and backward passes need the memory of a few images, while unfolding
    needs that of k * side^2. Distances are symmetric, so each is computed once for both pixels.
    Raises ValueError for an even side or a dilation below 1.

    >>> features, sharpness = torch.zeros(1, 2, 5, 5), torch.ones(1, 1, 5, 5)
    >>> affinity_sum(features, sharpness, torch.ones(1, 1, 5, 5), side=3)[0, 0, 2, 2].item()
    8.0
    """
    return _sum(features, sharpness, None, source, side, dilation)


def cross_affinity_sum(
    features: Float[Tensor, "n k h w"],
    sharpness: Float[Tensor, "n 1 h w"],
    source_features: Float[Tensor, "n k h w"],
    source: Float[Tensor, "n c h w"],
    side: int,
    dilation: int = 1,
) -> Float[Tensor, "n c h w"]:
    """Sum over a window q around pixel p of exp(-a_p |f_p - g_q|^2) source_q, including q = p.

    As `affinity_sum`, between two images: `source_features` g belong to `source`, for example to
    the previous frame.
    """
    return _sum(features, sharpness, source_features, source, side, dilation)


def _sum(
    features: Tensor,
    sharpness: Tensor,
    source_features: Tensor | None,
    source: Tensor,
    side: int,
    dilation: int,
) -> Tensor:
    """The sum; `source_features` None means the same image, without the pixel itself.

    Rows are joined end to end, separated by zeros wide enough for any tap beyond a border. Each tap
    is then one shift of the joined rows, and every read and write is contiguous.
    """
    if side < 1 or side % 2 == 0 or dilation < 1:
        raise ValueError(
            f"a window needs an odd side and a dilation of 1 or more, not {side} and {dilation}"
        )
    h, w = source.shape[-2:]
    reach = side // 2 * dilation
    features, sharpness, source = (
        F.pad(image, (0, reach)).flatten(2) for image in (features, sharpness, source)
    )
    others = None if source_features is None else F.pad(source_features, (0, reach)).flatten(2)
    rows, pitch = (features, sharpness, others, source), w + reach
    total: Tensor
    if is_compiling():
        total = _sum_windows(*rows, box_stencil(side // 2), pitch, dilation)
    else:
        shifts = _tap_shifts(side, dilation, pitch, others is None)
        total = _AffinitySum.apply(*rows, shifts)  # type: ignore[no-untyped-call]
    return total.view(*total.shape[:2], h, pitch)[..., :w]


def _sum_windows(
    features: Tensor,
    sharpness: Tensor,
    source_features: Tensor | None,
    source: Tensor,
    stencil: Stencil,
    pitch: int,
    dilation: int,
) -> Float[Tensor, "n c row"]:
    """All taps of a pixel at once: what a compiler makes one loop of."""
    windows = partial(read_windows, pitch=pitch, reach=stencil.reach, step=dilation)
    others = windows(features if source_features is None else source_features)
    pairs = zip(features.unbind(1), others.unbind(1), strict=True)
    distance = sum((own[:, None, None] - other).square() for own, other in pairs)
    weight = (-sharpness[:, :, None] * distance).clamp_min(MIN_LOG_WEIGHT).exp()
    if source_features is None:
        weight = weight.where(stencil.squares(weight)[1] > 0, 0.0)
    return (windows(source) * weight[:, None]).sum((2, 3))


def _tap_shifts(side: int, dilation: int, pitch: int, symmetric: bool) -> tuple[int, ...]:
    """Shift of each tap along the joined rows; if symmetric, only taps ahead of the centre."""
    steps = range(-(side // 2), side // 2 + 1)
    taps = ((y, x) for y in steps for x in steps if not symmetric or (y, x) > (0, 0))
    return tuple(dilation * (y * pitch + x) for y, x in taps)


class _AffinitySum(torch.autograd.Function):
    """Computes weights tap by tap without storing them; the backward pass computes them again."""

    @staticmethod
    def forward(
        ctx: Any,
        features: Tensor,
        sharpness: Tensor,
        source_features: Tensor | None,
        source: Tensor,
        shifts: tuple[int, ...],
    ) -> Tensor:
        ctx.save_for_backward(features, sharpness, source_features, source)
        ctx.shifts = shifts
        total = torch.zeros_like(source)
        for p, q in _strip_pairs(source, shifts):
            distance = _difference(features, source_features, p, q).square_().sum(1, keepdim=True)
            for target, origin in _directions(source_features, p, q):
                weight = _weight(sharpness[..., target], distance)
                total[..., target].addcmul_(weight, source[..., origin])
        return total

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        features, sharpness, source_features, source = ctx.saved_tensors
        grad_features, grad_sharpness = torch.zeros_like(features), torch.zeros_like(sharpness)
        grad_others = (
            grad_features if source_features is None else torch.zeros_like(source_features)
        )
        grad_source = torch.zeros_like(source)
        grad = grad.contiguous()
        for p, q in _strip_pairs(source, ctx.shifts):
            difference = _difference(features, source_features, p, q)
            distance = difference.square().sum(1, keepdim=True)
            slope = torch.zeros_like(distance)  # gradient by features at q, per unit of difference
            for target, origin in _directions(source_features, p, q):
                weight = _weight(sharpness[..., target], distance)
                grad_source[..., origin].addcmul_(weight, grad[..., target])
                by_log_weight = (
                    (grad[..., target] * source[..., origin]).sum(1, keepdim=True).mul_(weight)
                )
                grad_sharpness[..., target].addcmul_(by_log_weight, distance, value=-1)
                slope.addcmul_(by_log_weight, sharpness[..., target], value=2)
            difference.mul_(slope)
            grad_features[..., p].sub_(difference)
            grad_others[..., q].add_(difference)
        by_others = None if source_features is None else grad_others
        return grad_features, grad_sharpness, by_others, grad_source, None


def _strip_pairs(like: Tensor, shifts: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    """Strips of pixels p, and for each tap the pixels q that it shifts them to."""
    length = like.shape[-1]
    strip = STRIP_PIXELS if like.device.type == "cpu" else length
    for start in range(0, length, strip):
        for shift in shifts:
            first, end = max(start, -shift), min(start + strip, length, length - shift)
            if first < end:
                yield slice(first, end), slice(first + shift, end + shift)


def _weight(sharpness: Tensor, distance: Tensor) -> Tensor:
    return torch.mul(sharpness, distance).neg_().clamp_min_(MIN_LOG_WEIGHT).exp_()


def _difference(features: Tensor, source_features: Tensor | None, p: slice, q: slice) -> Tensor:
    return features[..., p] - (features if source_features is None else source_features)[..., q]


def _directions(
    source_features: Tensor | None, p: slice, q: slice
) -> tuple[tuple[slice, slice], ...]:
    """Pairs (target, origin): within one image, each pixel receives from the other."""
    return ((p, q), (q, p)) if source_features is None else ((p, q),)
