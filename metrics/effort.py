"""Where the samples of a frame went: does effort follow error, and how many pixels hit the cap.

`counts` are the samples drawn in each pixel, pilot included.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float, Float64, Int
from torch import Tensor

__all__ = [
    "at_cap",
    "centre_ranks",
    "correlate_ranks",
    "effort_error",
    "rank_correlation",
    "scene_noise",
]

NOISE_WINDOW = 7  # pixels: side of the square over which the noise of the halves is averaged
MAX_BINS = 2**12  # range of integers that are ranked by counting


def effort_error(
    count_ranks: Float64[Tensor, "n pixels"], error: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Rank correlation of sample counts with the error that is left, in [-1, 1].

    Spearman's, of the counts and the squared display error (`Comparison.display_error`), mean over
    channels, of each pixel of the method's own image. Well above 0: most error is left where most
    samples went, so these pixels still had too few. Near 0: effort has evened the error out, or
    ignored it; the correlation with `scene_noise` tells which. Equal counts score 0. A pixel that
    is not finite has the largest error, 1.

    >>> error = torch.tensor([0.0, -0.1, 0.2, 0.3]).view(1, 1, 2, 2).expand(1, 3, 2, 2)
    >>> effort_error(centre_ranks(torch.tensor([[[[1, 2], [4, 8]]]])), error)
    tensor([1.])
    """
    if not count_ranks.any():  # equal counts: errors need not be sorted
        return torch.zeros(len(count_ranks), device=count_ranks.device)
    squares = error.square().nan_to_num(nan=1.0)
    return correlate_ranks(count_ranks, centre_ranks(squares.mean(1, keepdim=True)))


def scene_noise(
    display_a: Float[Tensor, "n 3 h w"], display_b: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, "n 1 h w"]:
    """The noise of the scene in each pixel, which a method's effort should follow.

    The squared difference of the two reference halves, both in clipped sRGB, mean over channels and
    over NOISE_WINDOW x NOISE_WINDOW pixels: both halves have equally many samples in every pixel,
    so it is proportional to the variance of one sample. It is the same for all methods, unlike the
    error of their images, and so the rank correlation of counts with it shows what a method meant
    to do. Differs from the variance itself by the noise of one pair of halves, which lowers the
    correlation of a perfect density below 1.

    >>> display_a = torch.zeros(1, 3, 1, 64)
    >>> display_b = torch.linspace(0, 1, 64).expand(1, 3, 1, 64)
    >>> rising = torch.arange(64).view(1, 1, 1, 64) // 8
    >>> rank_correlation(rising, scene_noise(display_a, display_b)) > 0.95
    tensor([True])
    """
    noise = (display_a - display_b).square().mean(1, keepdim=True)
    for dim in (2, 3):  # the mean over the pixels of a square that are inside the image
        noise = _sum_window(noise, dim) / _sum_window(torch.ones_like(noise), dim)
    return noise


def at_cap(counts: Int[Tensor, "n 1 h w"], max_samples: int) -> Float[Tensor, " n"]:
    """Share of pixels with `max_samples` samples, in percent.

    Many pixels at the cap say that the method wanted more there than it could have: the paper of
    Scardigli et al. 2023 reports fewer than 0.6 % at 8 samples.

    >>> at_cap(torch.tensor([[[[8, 1], [0, 8]]]]), max_samples=8)
    tensor([50.])
    """
    return 100 * (counts >= max_samples).flatten(1).float().mean(1)


def rank_correlation(
    x: Float[Tensor, "n 1 h w"] | Int[Tensor, "n 1 h w"],
    y: Float[Tensor, "n 1 h w"] | Int[Tensor, "n 1 h w"],
) -> Float[Tensor, " n"]:
    """Spearman's rank correlation over the pixels of each image, in [-1, 1].

    Spearman 1904, The Proof and Measurement of Association between Two Things: the correlation of
    ranks, equal values sharing their mean rank. Ranks, because errors have heavy tails: Pearson's
    correlation would be that of a few fireflies, and counts need not be proportional to errors.
    Where all x or all y are equal, the correlation is undefined; it is 0 here.

    >>> rank_correlation(torch.tensor([[[[1, 2, 3]]]]), torch.tensor([[[[0.1, 50.0, 0.2]]]]))
    tensor([0.5000])
    """
    return correlate_ranks(centre_ranks(x), centre_ranks(y))


def centre_ranks(
    values: Float[Tensor, "n 1 h w"] | Int[Tensor, "n 1 h w"],
) -> Float64[Tensor, "n pixels"]:
    """Ranks of the pixels of each image, less their mean; equal values share their mean rank.

    >>> centre_ranks(torch.tensor([[[[0.1, 50.0, 0.2, 0.2]]]]))
    tensor([[-1.5000,  1.5000,  0.0000,  0.0000]], dtype=torch.float64)
    """
    return torch.stack([_centre_ranks(each) for each in values.flatten(1)])


def correlate_ranks(
    x: Float64[Tensor, "n pixels"], y: Float64[Tensor, "n pixels"]
) -> Float[Tensor, " n"]:
    """Correlation of ranks that `centre_ranks` made; 0 where all of x or all of y are equal.

    >>> rising = centre_ranks(torch.tensor([[[[1, 2, 3]]]]))
    >>> correlate_ranks(rising, -rising)
    tensor([-1.])
    """
    size = (x.square().sum(1) * y.square().sum(1)).sqrt()
    return ((x * y).sum(1) / size).where(size > 0, 0.0).float()


def _sum_window(values: Tensor, dim: int) -> Tensor:
    """Sums of NOISE_WINDOW neighbours along rows (3) or columns (2), 0 beyond the image."""
    reach = NOISE_WINDOW // 2
    padded = F.pad(values, (reach, reach, 0, 0) if dim == 3 else (0, 0, reach, reach))
    total = torch.zeros_like(values)
    for offset in range(NOISE_WINDOW):  # avg_pool2d takes five times as long
        total += padded.narrow(dim, offset, values.shape[dim])
    return total


def _centre_ranks(values: Tensor) -> Tensor:
    """The ranks of one image."""
    keys = _ordered_integers(values)
    least = int(keys.min())
    if int(keys.max()) - least <= MAX_BINS:  # counts: nothing needs to be sorted
        group = (keys - least).long()
        return _group_ranks(torch.bincount(group))[group]
    ascending, order = keys.sort()
    _, group, sizes = torch.unique_consecutive(ascending, return_inverse=True, return_counts=True)
    ranks = _group_ranks(sizes)[group]
    return torch.empty_like(ranks).scatter_(0, order, ranks)


def _group_ranks(sizes: Tensor) -> Tensor:
    """The mean rank of each group of equal values in ascending order, less that of all."""
    middle: Tensor = sizes.cumsum(0).double() - (sizes - 1) / 2
    return middle - (int(sizes.sum()) + 1) / 2


def _ordered_integers(values: Tensor) -> Tensor:
    """Integers in the order of the values, which have no NaN: they are sorted by their digits.

    Bits of floats are ordered as integers are, those of negative ones the other way round.
    """
    if not values.is_floating_point():
        return values
    bits = (values + 0.0).view(torch.int64 if values.dtype == torch.float64 else torch.int32)
    return torch.where(bits < 0, bits ^ torch.iinfo(bits.dtype).max, bits)  # -0.0 became 0.0
