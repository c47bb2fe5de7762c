"""Sums over those neighbours whose features are alike, without unfolding the image."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

STRIP = 2**15  # pixels taken at a time on a CPU, so that features and sums stay in its cache
FARTHEST = -60.0  # log weight below which none goes: subnormal floats would be ten times slower


def affinity_sum(
    features: Float[Tensor, "n k h w"],
    sharpness: Float[Tensor, "n 1 h w"],
    source: Float[Tensor, "n c h w"],
    side: int,
    dilation: int = 1,
) -> Float[Tensor, "n c h w"]:
    """Sum over neighbours q of pixel p of exp(-a_p |f_p - f_q|^2) source_q, without p itself.

    Neighbours are the pixels of the image at (p_x + i dilation, p_y + j dilation) with
    |i|, |j| <= side // 2, side odd; what lies beyond the border does not count. With a channel of
    ones in `source` the sum of weights comes out beside the weighted sums. Features f of any
    range, sharpness a >= 0. Weights below exp(-60) are exp(-60).

    The kernels are those of Isik et al. 2021, Interactive Monte Carlo Denoising using Affinity of
    Neural Features. Needs the memory of a few images, forward as well as backward, where unfolding
    needs that of k * side * side. Distances are symmetric, so each is made once for both its
    pixels. Raises ValueError for an even side or a dilation below 1.
    """
    return _sum(features, sharpness, None, source, side, dilation)


def cross_affinity_sum(
    features: Float[Tensor, "n k h w"],
    sharpness: Float[Tensor, "n 1 h w"],
    others: Float[Tensor, "n k h w"],
    source: Float[Tensor, "n c h w"],
    side: int,
    dilation: int = 1,
) -> Float[Tensor, "n c h w"]:
    """The same against another image: the sum of exp(-a_p |f_p - g_q|^2) source_q, p included.

    `others` g are the features of `source`, such as those of the frame before.
    """
    return _sum(features, sharpness, others, source, side, dilation)


def _sum(
    features: Tensor,
    sharpness: Tensor,
    others: Tensor | None,
    source: Tensor,
    side: int,
    dilation: int,
) -> Tensor:
    """Rows are joined end to end, with zeros between them that any tap beyond a border falls on.

    A tap is then one shift along the whole image, and all that it touches lies contiguous.
    """
    if side < 1 or side % 2 == 0 or dilation < 1:
        raise ValueError(
            f"a window has an odd side and a dilation of 1 or more, not {side} and {dilation}"
        )
    h, w = source.shape[-2:]
    reach = side // 2 * dilation
    flat = [
        None if image is None else F.pad(image, (0, reach)).flatten(2)
        for image in (features, sharpness, others, source)
    ]
    taps = _shifts(side, dilation, w + reach, others is None)
    total: Tensor = _Alike.apply(*flat, taps)  # type: ignore[no-untyped-call]
    return total.view(*total.shape[:2], h, w + reach)[..., :w]


def _shifts(side: int, dilation: int, row: int, mutual: bool) -> tuple[int, ...]:
    """How far each tap lies along the joined rows; of mutual ones, only those that lie ahead."""
    steps = range(-(side // 2), side // 2 + 1)
    ahead = ((y, x) for y in steps for x in steps if not mutual or (y, x) > (0, 0))
    return tuple(dilation * (y * row + x) for y, x in ahead)


class _Alike(torch.autograd.Function):
    """Weights are made tap by tap and thrown away; the backward pass makes them again."""

    @staticmethod
    def forward(
        ctx: Any,
        features: Tensor,
        sharpness: Tensor,
        others: Tensor | None,
        source: Tensor,
        taps: tuple[int, ...],
    ) -> Tensor:
        ctx.save_for_backward(features, sharpness, others, source)
        ctx.taps = taps
        total = torch.zeros_like(source)
        for p, q in _pairs(source, taps):
            distance = _difference(features, others, p, q).square_().sum(1, keepdim=True)
            for here, there in _ways(others, p, q):
                weight = _weight(sharpness[..., here], distance)
                total[..., here].addcmul_(weight, source[..., there])
        return total

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        features, sharpness, others, source = ctx.saved_tensors
        by_features, by_sharpness = torch.zeros_like(features), torch.zeros_like(sharpness)
        by_others = by_features if others is None else torch.zeros_like(others)
        by_source = torch.zeros_like(source)
        slope = slope.contiguous()
        for p, q in _pairs(source, ctx.taps):
            difference = _difference(features, others, p, q)
            distance = difference.square().sum(1, keepdim=True)
            steep = torch.zeros_like(distance)
            for here, there in _ways(others, p, q):
                weight = _weight(sharpness[..., here], distance)
                by_source[..., there].addcmul_(weight, slope[..., here])
                rise = (slope[..., here] * source[..., there]).sum(1, keepdim=True).mul_(weight)
                by_sharpness[..., here].addcmul_(rise, distance, value=-1)
                steep.addcmul_(rise, sharpness[..., here], value=2)
            difference.mul_(steep)
            by_features[..., p].sub_(difference)
            by_others[..., q].add_(difference)
        return by_features, by_sharpness, None if others is None else by_others, by_source, None


def _pairs(like: Tensor, taps: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    """Pixels p, a strip at a time, and for each tap the pixels q that it takes them to."""
    length = like.shape[-1]
    strip = STRIP if like.device.type == "cpu" else length
    for start in range(0, length, strip):
        for tap in taps:
            first, end = max(start, -tap), min(start + strip, length, length - tap)
            if first < end:
                yield slice(first, end), slice(first + tap, end + tap)


def _weight(sharpness: Tensor, distance: Tensor) -> Tensor:
    return torch.mul(sharpness, distance).neg_().clamp_min_(FARTHEST).exp_()


def _difference(features: Tensor, others: Tensor | None, p: slice, q: slice) -> Tensor:
    return features[..., p] - (features if others is None else others)[..., q]


def _ways(others: Tensor | None, p: slice, q: slice) -> tuple[tuple[slice, slice], ...]:
    """Who takes from whom: among neighbours in one image, each from the other."""
    return ((p, q), (q, p)) if others is None else ((p, q),)
