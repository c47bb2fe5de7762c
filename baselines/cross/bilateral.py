"""The cross-bilateral filter of both pilots, with the gradient by its bandwidths."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from baselines.cross.pilots import mirror

SIDE = 11  # pixels
REACH = SIDE // 2
STRIP_PIXELS = 2**14  # on a CPU, so that a strip stays in its cache
MIN_LOG_WEIGHT = -60.0  # lower bound of log weights; subnormal floats are ten times slower


def filter_pilots(
    pilots: Float[Tensor, "n 6 h w"],
    surface: Float[Tensor, "n 6 h w"],
    bands: Float[Tensor, "n 5 h w"],
) -> Float[Tensor, "n 2 4 h w"]:
    """For both pilots the weighted sums over 11 x 11 pixels of 3 channels, and of the weights.

    The weight of q at p is exp(-b_i |pilot_p - pilot_q|^2 - b_3 |albedo_p - albedo_q|^2
    - b_4 |normal_p - normal_q|^2 - b_5 |p - q|^2 / 25) with the `bands` of p; i is 1 or 2, the
    pilot. `surface` is albedo and normal. Images are mirrored at borders. Gradients are those by
    `bands` alone; the backward pass computes weights again, so no memory grows with the window.
    """
    sums: Tensor = _FilterPilots.apply(torch.cat((pilots, surface), 1), bands)  # type: ignore[no-untyped-call]
    return sums


class _FilterPilots(torch.autograd.Function):
    """Rows of images padded for all taps, so that a tap is a shift and its reads are contiguous."""

    @staticmethod
    def forward(ctx: Any, images: Tensor, bands: Tensor) -> Tensor:
        ctx.save_for_backward(images, bands)
        n, _, h, w = images.shape
        rows, band_rows = _join_rows(images), _join_rows(bands, 0)
        sums = images.new_zeros(n, 2, 4, band_rows.shape[2])
        for place, p, q, distance in _pairs(w, sums.shape[3], sums.is_cuda):
            weight, _ = _weigh(rows[..., p], rows[..., q], band_rows[..., place], distance)
            sums[..., place].addcmul_(_values(rows[..., q]), weight[:, :, None])
        return _split_rows(sums, h, w)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[None, Tensor]:
        images, bands = ctx.saved_tensors
        h, w = images.shape[2:]
        rows, band_rows = _join_rows(images), _join_rows(bands, 0)
        grad_rows = torch.unflatten(_join_rows(grad.flatten(1, 2), 0), 1, (2, 4))
        gradient = torch.zeros_like(band_rows)
        for place, p, q, distance in _pairs(w, band_rows.shape[2], images.is_cuda):
            weight, squares = _weigh(rows[..., p], rows[..., q], band_rows[..., place], distance)
            slope = (grad_rows[..., place] * _values(rows[..., q])).sum(2).mul_(weight)
            both = slope.sum(1, keepdim=True)
            part = gradient[..., place]
            part[:, :2].addcmul_(slope, squares[:, :2], value=-1)
            part[:, 2:4].addcmul_(both, squares[:, 2:], value=-1)
            part[:, 4:].add_(both, alpha=-distance)
        return None, _split_rows(gradient, h, w)


def _join_rows(image: Float[Tensor, "n c h w"], border: int = REACH) -> Float[Tensor, "n c row"]:
    """Rows end to end, each with space for the taps beyond both of its ends."""
    if border:
        image = mirror(image, border)
        ones = torch.ones_like(image[:, :1])
        return torch.cat((image, ones), 1).flatten(2)
    return F.pad(image, (0, 2 * REACH)).flatten(2)


def _split_rows(rows: Float[Tensor, "n *c row"], h: int, w: int) -> Float[Tensor, "n *c h w"]:
    """The images of rows joined with a border of 0."""
    return torch.unflatten(rows, -1, (h, w + 2 * REACH))[..., :w]


def _pairs(w: int, length: int, is_cuda: bool) -> Iterator[tuple[slice, slice, slice, float]]:
    """Strips: their place in rows of results, pixels p, pixels q, and |p - q|^2 / 25."""
    pitch = w + 2 * REACH
    centre, end = REACH * pitch + REACH, length - 2 * REACH
    strip = end if is_cuda else STRIP_PIXELS
    for start in range(0, end, strip):
        stop = min(start + strip, end)
        for y in range(-REACH, REACH + 1):
            for x in range(-REACH, REACH + 1):
                shift = centre + y * pitch + x
                p = slice(start + centre, stop + centre)
                q = slice(start + shift, stop + shift)
                yield slice(start, stop), p, q, (y * y + x * x) / REACH**2


def _weigh(p: Tensor, q: Tensor, bands: Tensor, distance: float) -> tuple[Tensor, Tensor]:
    """Weights of both pilots, and squared distances of pilots, albedo and normal [n 4 row]."""
    squares = torch.unflatten((p[:, :12] - q[:, :12]).square_(), 1, (4, 3)).sum(2)
    terms = bands[:, :4] * squares
    shared = torch.add(terms[:, 2:].sum(1, keepdim=True), bands[:, 4:], alpha=distance)
    return (terms[:, :2] + shared).neg_().clamp_min_(MIN_LOG_WEIGHT).exp_(), squares


def _values(q: Tensor) -> Float[Tensor, "n 2 4 row"]:
    """Both pilots, each with a channel of ones."""
    ones = q[:, 12:]
    return torch.unflatten(torch.cat((q[:, :3], ones, q[:, 3:6], ones), 1), 1, (2, 4))
