"""SSIM and MS-SSIM of images that a convention has encoded, in [0, 1].

Four Gaussian means are enough: of x, xy and x^2 + y^2, since both variances occur as their sum, and
of y, which serves all images that are compared with the reference (`reference_windows`).
A Gaussian is separable, and each pass is a product with a banded matrix, in blocks of 32 outputs
from 42 inputs: it takes four times as many multiplications as 11 taps, but a matrix product does
20 times as many a second as a convolution of single channels. Strips of 32 rows stay in the cache.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Float64
from torch import Tensor

__all__ = [
    "SCALE_WEIGHTS",
    "ReferenceWindows",
    "SimilarityTerms",
    "check_scales",
    "combine_scales",
    "max_scales",
    "ms_ssim",
    "reference_windows",
    "similarity_terms",
    "ssim",
]

SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # Wang et al. 2003, from fine to coarse
WINDOW = 11  # taps of the Gaussian
SIGMA = 1.5
C1, C2 = 0.01**2, 0.03**2  # Wang et al. 2004, of a range of 1
BLOCK = 32  # rows of a strip, and columns of a block


def ssim(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Structural similarity of encoded images, in [-1, 1]; higher is better.

    Wang, Bovik, Sheikh, Simoncelli 2004, Image Quality Assessment: From Error Visibility to
    Structural Similarity: the mean over channels and windows, those that lie inside the image, of
    the luminance, contrast and structure terms, for a Gaussian window of 11 x 11 pixels, sigma 1.5,
    and a range of 1. Variances are those of the window, not of a population. Raises ValueError if a
    side is below 11 pixels.

    >>> image = torch.rand(1, 3, 32, 48, generator=torch.Generator().manual_seed(0))
    >>> ssim(image, image), ssim(1 - image, image) < 0
    (tensor([1.]), tensor([True]))
    """
    return similarity_terms(image, *reference_windows(reference)).ssim


def ms_ssim(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"], scales: int = 5
) -> Float[Tensor, " n"]:
    """Multi-scale structural similarity of encoded images, in [0, 1]; higher is better.

    Wang, Simoncelli, Bovik 2003, Multiscale Structural Similarity for Image Quality Assessment:
    the product over scales of contrast and structure terms, and the luminance term at the coarsest
    scale, with the exponents SCALE_WEIGHTS, for each channel by itself. As in pytorch-msssim, a
    negative term counts as 0, so that no power of it is NaN, and odd sides are padded with zeros
    before they are halved.

    With fewer than 5 `scales` the coarsest are left out, and the other weights are scaled to the
    sum of all; that is a different metric and needs a different name. Raises ValueError if a side
    is too small for `scales`.

    >>> image = torch.rand(1, 3, 64, 96, generator=torch.Generator().manual_seed(0))
    >>> ms_ssim(image, image, max_scales(64, 96))
    tensor([1.])
    """
    return combine_scales(image, reference_windows(reference, scales))


def combine_scales(
    image: Float[Tensor, "n 3 h w"],
    windows: Sequence[ReferenceWindows],
    finest: SimilarityTerms | None = None,
) -> Float[Tensor, " n"]:
    """MS-SSIM of an image and the reference of these `windows`, from fine to coarse.

    `finest` are the terms of the first scale, if they are known.

    >>> image = torch.rand(1, 3, 64, 96, generator=torch.Generator().manual_seed(0))
    >>> combine_scales(image, reference_windows(image, scales=2))
    tensor([1.])
    """
    normalisation = math.fsum(SCALE_WEIGHTS) / math.fsum(SCALE_WEIGHTS[: len(windows)])
    score = torch.ones_like(image[:, :, 0, 0])
    for scale, (reference, weight) in enumerate(zip(windows, SCALE_WEIGHTS, strict=False)):
        terms = (finest if scale == 0 else None) or similarity_terms(image, reference)
        is_coarsest = scale == len(windows) - 1
        term = terms.similarity if is_coarsest else terms.contrast
        score = score * term.float().clamp_min(0) ** (weight * normalisation)
        image = image if is_coarsest else _halve(image)
    return score.mean(1)


def max_scales(height: int, width: int) -> int:
    """Largest number of scales of MS-SSIM, 0 to 5, whose coarsest image holds a whole window.

    >>> max_scales(1080, 1920), max_scales(96, 128), max_scales(10, 10)
    (5, 4, 0)
    """
    halvings = (min(height, width) - 1) // (WINDOW - 1)
    return min(halvings.bit_length(), len(SCALE_WEIGHTS))


class SimilarityTerms(NamedTuple):
    """Means over the windows of each channel, in float64 and [-1, 1]."""

    similarity: Float64[Tensor, "n 3"]  # of luminance x contrast x structure
    contrast: Float64[Tensor, "n 3"]  # of contrast x structure

    @property
    def ssim(self) -> Float[Tensor, " n"]:
        """The structural similarity: the mean over channels."""
        return self.similarity.mean(1).float()


class ReferenceWindows(NamedTuple):
    """A reference at one scale, and its Gaussian means over all windows, by tiles."""

    image: Float[Tensor, "n 3 h w"]
    means: Sequence[Float[Tensor, "1 tiles n 3 rows columns"]]


def reference_windows(
    reference: Float[Tensor, "n 3 h w"], scales: int = 1
) -> list[ReferenceWindows]:
    """What `similarity_terms` reads of an encoded reference, at full size and then half and half.

    Raises ValueError if a side is too small for `scales`.

    >>> [each.image.shape[-1] for each in reference_windows(torch.rand(1, 3, 64, 96), scales=3)]
    [96, 48, 24]
    """
    check_scales(reference, scales)
    windows: list[ReferenceWindows] = []
    for _ in range(scales):
        image = _halve(windows[-1].image) if windows else reference
        means = list(_window_means(lambda y: (y,), image))
        windows.append(ReferenceWindows(image, means))
    return windows


def similarity_terms(
    image: Float[Tensor, "n 3 h w"], reference: ReferenceWindows
) -> SimilarityTerms:
    """What `ssim` and the finest scale of `ms_ssim` share, of images of one size.

    >>> image = torch.rand(1, 3, 32, 48, generator=torch.Generator().manual_seed(0))
    >>> similarity_terms(image, *reference_windows(image)).contrast.float()
    tensor([[1., 1., 1.]])
    """
    similarity = contrast = torch.zeros_like(image[:, :, 0, 0], dtype=torch.float64)
    tiles = _window_means(lambda x, y: (x, x * y, x * x + y * y), image, reference.image)
    for (x, product, squares), (y,) in zip(tiles, reference.means, strict=True):
        mean_product, mean_squares = x * y, x * x + y * y
        structure = (2 * (product - mean_product) + C2) / (squares - mean_squares + C2)
        luminance = (2 * mean_product + C1) / (mean_squares + C1)
        contrast = contrast + structure.sum((0, -2, -1), dtype=torch.float64)
        similarity = similarity + (luminance * structure).sum((0, -2, -1), dtype=torch.float64)
    windows = (image.shape[-2] - WINDOW + 1) * (image.shape[-1] - WINDOW + 1)
    # variances are differences of float32 squares, so those of flat images may be below 0
    return SimilarityTerms(*((term / windows).clamp(-1, 1) for term in (similarity, contrast)))


def _window_means(moments: Callable[..., Sequence[Tensor]], *images: Tensor) -> Iterator[Tensor]:
    """Gaussian means of the moments of images over all windows, by tiles [m tiles n 3 r c]."""
    (n, channels, height, width), reach = images[0].shape, WINDOW - 1
    blocks, rest = divmod(width - reach, BLOCK)
    band = partial(_band, dtype=images[0].dtype, device=images[0].device)
    to_block = band(BLOCK).expand(blocks, -1, -1)
    for top in range(0, height - reach, BLOCK):
        rows = min(BLOCK, height - reach - top)
        strip = moments(*(each[..., top : top + rows + reach, :] for each in images))
        columns = (band(rows).mT @ torch.stack(tuple(strip))).flatten(0, -2)
        shape = (len(strip), n, channels, rows)
        if blocks:
            inputs = columns.unfold(1, BLOCK + reach, BLOCK).transpose(0, 1)
            yield torch.bmm(inputs, to_block).view(blocks, *shape, BLOCK).movedim(1, 0)
        if rest:
            edge = columns[:, blocks * BLOCK :] @ band(rest)
            yield edge.view(shape[0], 1, n, channels, rows, rest)


@lru_cache(maxsize=4 * BLOCK)
@torch.inference_mode(False)  # or gradients could not pass a matrix that inference made
def _band(outputs: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """[outputs + 10, outputs]: a product with it takes Gaussian means of 11 values each."""
    reach = WINDOW // 2
    inputs = torch.arange(outputs + 2 * reach, device=device).unsqueeze(1)
    distance = inputs - reach - torch.arange(outputs, device=device)
    weights = torch.exp(-(distance**2) / (2 * SIGMA**2)).where(distance.abs() <= reach, 0.0)
    return (weights / weights.sum(0)).to(dtype)


def _halve(image: Tensor) -> Tensor:
    """Means of 2 x 2 pixels; odd sides are padded with zeros. avg_pool2d takes 4 times as long."""
    odd_rows, odd_columns = (side % 2 for side in image.shape[-2:])
    if odd_rows or odd_columns:
        image = F.pad(image, (odd_columns, odd_columns, odd_rows, odd_rows))
        image = image[..., : image.shape[-2] // 2 * 2, : image.shape[-1] // 2 * 2]
    rows = image[..., ::2, :] + image[..., 1::2, :]
    return (rows[..., ::2] + rows[..., 1::2]) / 4


def check_scales(image: Float[Tensor, "n 3 h w"], scales: int) -> None:
    """Raise ValueError if a side of the image is too small for `scales`.

    >>> check_scales(torch.zeros(1, 3, 11, 11), scales=1)
    """
    h, w = image.shape[-2:]
    if scales > max_scales(h, w):
        raise ValueError(
            f"SSIM at {scales} scales needs sides above {(WINDOW - 1) << (scales - 1)} "
            f"pixels, found {h} x {w}, which allow {max_scales(h, w)}. Use "
            "MS_SSIM.at(height, width) of metrics.catalog"
        )
