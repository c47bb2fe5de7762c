"""Cross-regression: each half of the samples is predicted from the other, in windows of 17 x 17."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from rlbench.frames import Samples
from rlbench.ops.fireflies import limit_fireflies

SIDE = 17  # pixels, side of the window of a regression
STEP = 4  # pixels between the centres of two windows
RIDGE = 1e-3  # added to the diagonal of the normal equations
MIN_WEIGHT = 1e-7  # of a pixel in a regression, and of a prediction in a mean
DEVIATION_OFFSET, VARIANCE_OFFSET = 1e-2, 1e-4  # added before dividing by either
COEFFICIENTS = 6  # of 1, the colour of the other half, albedo, and the normal
MAX_LOG = 11.1  # log(1 + radiance) of the largest half float
CENTRES = 2048  # windows that are solved together: bounds the memory
REACH = SIDE // 2
CELLS = REACH // STEP  # cells of STEP x STEP pixels on each side whose window reaches a pixel


def split_halves(samples: Samples) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 3 h w"]]:
    """Means of the samples in even and in odd slots; a half without samples gets the other's."""
    radiance = limit_fireflies(samples.radiance, samples.counts).clamp_min(0)
    counts = samples.counts.to(radiance.dtype)
    all_samples = radiance.sum(1) / counts.clamp_min(1)
    halves = []
    for first, count in ((0, ((counts + 1) / 2).floor()), (1, (counts / 2).floor())):
        mean = radiance[:, first::2].sum(1) / count.clamp_min(1)
        halves.append(torch.where(count > 0, mean, all_samples))
    return halves[0], halves[1]


def regress(
    explaining: Float[Tensor, "n 3 h w"],
    response: Float[Tensor, "n 3 h w"],
    albedo: Float[Tensor, "n 3 h w"],
    normal: Float[Tensor, "n 3 h w"],
) -> Float[Tensor, "n 3 h w"]:
    """The response as the other half and the surface explain it, >= 0: linear in the response.

    At every fourth pixel along both axes a linear model of each channel is fitted to the window of
    17 x 17 pixels around it, mirrored at borders. It explains the response by 1, the difference of
    the other half's colour to that of the centre over the sum of both deviations, and the
    differences of albedo and normal. Pixels weigh exp(-|difference of colours|^2 / sum of both
    variances). A pixel gets the mean, weighted in the same way, of the predictions of all windows
    that hold it.
    """
    variance = estimate_variance(explaining)
    guide = torch.cat((explaining, albedo, normal, variance, variance.sqrt()), 1)
    return _predict(guide, _fit(guide, response))


def estimate_variance(image: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 1 h w"]:
    """The squared distance of each pixel from the mean of its up to eight neighbours."""
    h, w = image.shape[2:]
    padded = F.pad(torch.cat((image, torch.ones_like(image[:, :1])), 1), (1, 1, 1, 1))
    rows = padded[..., :w] + padded[..., 1 : 1 + w] + padded[..., 2:]
    total = rows[..., :h, :] + rows[..., 1 : 1 + h, :] + rows[..., 2:, :]
    neighbours = total - padded[..., 1 : 1 + h, 1 : 1 + w]
    mean = neighbours[:, :3] / neighbours[:, 3:].clamp_min(1)
    return (image - mean).square().sum(1, keepdim=True)


def _fit(
    guide: Float[Tensor, "n 11 h w"], response: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, "n 18 rows columns"]:
    """The coefficients of all windows, those of a channel together."""
    images = mirror(torch.cat((guide, response), 1), REACH)
    windows = images.unfold(2, SIDE, STEP).unfold(3, SIDE, STEP)  # n 14 rows columns 17 17
    n, _, rows, columns = windows.shape[:4]
    strips = []
    for strip in _strips(rows, columns):
        pixels = windows[:, :, strip].flatten(4).flatten(2, 3)  # n 14 windows 289
        centre = pixels[..., SIDE * SIDE // 2, None]
        terms, weight = _explain(pixels[:, :11], centre[:, :11])
        weighted = terms * weight[:, :, None]  # n 3 6 windows 289
        weighted, terms = (part.transpose(2, 3) for part in (weighted, terms))
        matrix = weighted @ terms.mT + RIDGE * torch.eye(COEFFICIENTS, device=guide.device)
        target = weighted @ pixels[:, 11:, :, :, None]
        factor, _ = torch.linalg.cholesky_ex(matrix)
        strips.append(torch.cholesky_solve(target, factor)[..., 0])  # n 3 windows 6
    solved = torch.cat(strips, 2).transpose(2, 3)
    return solved.reshape(n, 3 * COEFFICIENTS, rows, columns)


def mirror(image: Float[Tensor, "n c h w"], reach: int) -> Float[Tensor, "n c h2 w2"]:
    """The image with `reach` more pixels on all sides, mirrored at its border pixels.

    An image of `reach` pixels or fewer is mirrored several times.
    """
    h, w = image.shape[2:]
    if min(h, w) > reach:
        return F.pad(image, (reach,) * 4, mode="reflect")
    rows, columns = (_mirrored_indices(size, reach, image.device) for size in (h, w))
    return image[..., rows[:, None], columns]


def _mirrored_indices(size: int, reach: int, device: torch.device) -> Int[Tensor, " side"]:
    period = max(2 * size - 2, 1)
    position = torch.arange(-reach, size + reach, device=device) % period
    return torch.minimum(position, period - position) if size > 1 else 0 * position


def _strips(rows: int, columns: int) -> Iterator[slice]:
    """Rows of windows that are solved together."""
    step = max(1, CENTRES // columns)
    return (slice(row, min(row + step, rows)) for row in range(0, rows, step))


def _explain(
    pixel: Float[Tensor, "n 11 *size"], centre: Float[Tensor, "n 11 *size"]
) -> tuple[Float[Tensor, "n 3 6 *size"], Float[Tensor, "n 1 *size"]]:
    """What explains the response of each channel at a pixel, and the weight of the pixel."""
    difference, total = pixel[:, :9] - centre[:, :9], pixel[:, 9:] + centre[:, 9:]
    colour, albedo, normal = difference.chunk(3, 1)
    scaled = colour / (total[:, 1:] + DEVIATION_OFFSET)
    normals = normal[:, None].expand(-1, 3, *normal.shape[1:])
    varying = torch.cat((torch.stack((torch.ones_like(scaled), scaled, albedo), 2), normals), 2)
    distance = colour.square().sum(1, keepdim=True) / (total[:, :1] + VARIANCE_OFFSET)
    return varying, (-distance).exp() + MIN_WEIGHT


def _predict(
    guide: Float[Tensor, "n 11 h w"], coefficients: Float[Tensor, "n 18 rows columns"]
) -> Float[Tensor, "n 3 h w"]:
    """The weighted mean of the predictions of all windows that hold a pixel."""
    n, _, h, w = guide.shape
    rows, columns = coefficients.shape[2:]
    exists = torch.ones_like(coefficients[:, :1])
    centres = F.pad(torch.cat((guide[..., ::STEP, ::STEP], coefficients, exists), 1), (CELLS,) * 4)
    spread = centres.repeat_interleave(STEP, 2).repeat_interleave(STEP, 3)
    x, y = (torch.arange(size, device=guide.device) % STEP for size in (w, h))
    total, weights = torch.zeros_like(guide[:, :3]), torch.zeros_like(guide[:, :1])
    for down in range(2 * CELLS + 1):
        for right in range(2 * CELLS + 1):
            # pixels beyond the window: only the cell before can be too far
            reached = ((y + STEP * (CELLS - down)) <= REACH)[:, None] & (
                (x + STEP * (CELLS - right)) <= REACH
            )
            top, left = down * STEP, right * STEP
            model = spread[..., top : top + h, left : left + w]
            terms, weight = _explain(guide, model[:, :11])
            weight = weight * model[:, -1:] * reached
            beta = torch.unflatten(model[:, 11:-1], 1, (3, COEFFICIENTS))
            total = total + weight * (beta * terms).sum(2)
            weights = weights + weight
    return (total / weights.clamp_min(MIN_WEIGHT)).clamp(0, MAX_LOG)
