"""Square windows around each pixel: the largest value beside it, and the sum over the window.

The radius is a number, or a tensor with one of each image where nobody may ask for its value
(rlbench.ops.asking). Windows of such a radius are read by index, from tables of windows whose width
is a power of two, or of sums from the border on (Crow 1984).
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

__all__ = ["max_of_neighbours", "window_sum"]

Radius = Int[Tensor, "n 1 1 1"]


def max_of_neighbours(
    image: Float[Tensor, "n 1 h w"], radius: int | Radius, most: int, outside: float
) -> Float[Tensor, "n 1 h w"]:
    """The largest value of each window without its centre; pixels beyond the border are `outside`.

    A `radius` in a tensor is at least 1, and at most `most`.

    >>> image = torch.tensor([[[[3.0, 1.0, 2.0, 0.0]]]])
    >>> max_of_neighbours(image, 1, most=1, outside=-1.0).flatten().tolist()
    [1.0, 3.0, 1.0, 2.0]
    >>> max_of_neighbours(image, torch.ones(1, 1, 1, 1).long(), most=1, outside=-1.0)[0, 0, 0]
    tensor([1., 3., 1., 2.])
    """
    reach = radius if isinstance(radius, int) else most
    h, w = image.shape[-2:]
    padded = F.pad(image, (reach,) * 4, value=outside)
    sides = _largest_beside(padded, radius, reach, -1)
    rows = torch.maximum(sides, padded[..., reach : reach + w])
    above_and_below = _largest_beside(rows, radius, reach, -2)
    return torch.maximum(above_and_below, sides[..., reach : reach + h, :])


def _largest_beside(padded: Tensor, radius: int | Tensor, reach: int, dim: int) -> Tensor:
    """The largest of the `radius` values before and after each position, `reach` from both ends."""
    if isinstance(radius, int):
        return _largest_in_reach(padded, radius, dim)
    size = padded.shape[dim] - 2 * reach
    widest, width = padded, torch.ones_like(radius)  # largest of `width` values from each on
    level, step = padded, 1  # largest of `step` values from each on
    while 2 * step <= reach:
        level = torch.maximum(level, level.roll(-step, dim))  # what wraps around is never read
        step *= 2
        fits = radius >= step
        widest, width = torch.where(fits, level, widest), torch.where(fits, step, width)
    start = torch.arange(reach, reach + size, device=padded.device)
    start = start if dim == -1 else start[:, None]
    first = (start - radius, start - width, start + 1, start + 1 + radius - width)
    parts = [_take(widest, index, dim) for index in first]
    return torch.stack(parts).amax(0)


def _largest_in_reach(padded: Tensor, radius: int, dim: int) -> Tensor:
    """`_largest_beside` of a radius that reaches both ends."""
    size = padded.shape[dim] - 2 * radius
    largest, width = padded, 1  # of `width` values from each position on
    while width < radius:
        step = min(width, radius - width)
        largest = torch.maximum(
            largest.narrow(dim, 0, largest.shape[dim] - step),
            largest.narrow(dim, step, largest.shape[dim] - step),
        )
        width += step
    return torch.maximum(largest.narrow(dim, 0, size), largest.narrow(dim, radius + 1, size))


def window_sum(image: Float[Tensor, "n c h w"], radius: Radius) -> Float[Tensor, "n c h w"]:
    """The sum of each window; pixels beyond the border count as 0.

    Differences of sums in float64: within 1e-16 of the sum of a line, however dark the window.

    >>> window_sum(torch.ones(1, 1, 1, 4), torch.full((1, 1, 1, 1), 1)).flatten().tolist()
    [2.0, 3.0, 3.0, 2.0]
    """
    total = image.double()
    for dim, side in ((-1, (1, 0)), (-2, (0, 0, 1, 0))):
        table, size = F.pad(total.cumsum(dim), side), total.shape[dim]
        at = torch.arange(size, device=image.device)
        at = at if dim == -1 else at[:, None]
        first, end = (at - radius).clamp_min(0), (at + radius + 1).clamp_max(size)
        total = _take(table, end, dim) - _take(table, first, dim)
    return total.to(image.dtype)


def _take(image: Tensor, index: Tensor, dim: int) -> Tensor:
    """The values at an index along an axis, the same for all lines of an image."""
    shape = list(image.shape)
    shape[dim] = index.shape[dim]
    return image.gather(dim, index.expand(shape))
