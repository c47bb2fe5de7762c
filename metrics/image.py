"""How far one image is from its reference, per image of a batch; broken pixels count as errors."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from metrics.display import display

CAP_DB = 100.0  # PSNR of equal images; rounding to 8 bits alone gives 58.9 dB
LARGEST = 65504.0  # largest half float, the brightest that a clip's EXR files can hold
RELMSE_EPS = 1e-2  # keeps black pixels of the reference from dividing by zero
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # Wang et al. 2003, from fine to coarse
WINDOW = 11  # taps of the Gaussian, sigma 1.5
DARKEST = 1e-4  # least mean of a reference to which bias is related, times display white
NO_LUMINANCE = 1e6  # as K1 of SSIM it makes the luminance term 1: what is left is contrast


def psnr(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Peak signal-to-noise ratio in dB, peak 1, of clipped sRGB; from 0 to CAP_DB.

    A pixel that is not finite has the worst error there is, 1 in every channel.
    """
    error = (display(image) - display(reference)).square()
    error = error.masked_fill(nonfinite_mask(image), 1.0)
    mse = error.flatten(1).mean(1, dtype=torch.float64).clamp_min(10 ** (-CAP_DB / 10))
    return (-10 * mse.log10()).float()


def tpsnr(
    frames: Float[Tensor, "n 2 3 h w"], references: Float[Tensor, "n 2 3 h w"]
) -> Float[Tensor, " n"]:
    """PSNR in dB of how much each pixel changes since the frame before: what flickers, scores low.

    Peak 1, of clipped sRGB; the error is the change of the image less that of the reference, as in
    the temporal loss of Chaitanya et al. 2017, so what stays wrong from frame to frame is no error.
    A pixel that is not finite in one of the frames has the worst error there is, 2 in every
    channel, so that scores go from -6 to CAP_DB. Nothing is moved by motion: noise of the
    reference counts twice, and a blur over time is told by the PSNR of its frames, not here.
    """
    change = display(frames[:, 1]) - display(frames[:, 0])
    truth = display(references[:, 1]) - display(references[:, 0])
    error = (change - truth).square()
    error = error.masked_fill(nonfinite_mask(frames[:, 0]) | nonfinite_mask(frames[:, 1]), 4.0)
    mse = error.flatten(1).mean(1, dtype=torch.float64).clamp_min(10 ** (-CAP_DB / 10))
    return (-10 * mse.log10()).float()


def ms_ssim(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"], scales: int = 5
) -> Float[Tensor, " n"]:
    """Multi-scale structural similarity of clipped sRGB, in [0, 1] (Wang et al. 2003).

    Computed by pytorch-msssim, where negative contrast counts as 0, so that no power of it is NaN,
    and odd sides are padded by zeros before they are halved. With fewer than 5 `scales` the
    coarsest are left out and the other weights scaled to the sum of all; that is another metric
    and needs another name. A pixel that is not finite is shown as black or white, whichever is
    further from the reference. Raises ValueError where a side is too small for `scales`.
    """
    h, w = image.shape[-2:]
    if scales > max_scales(h, w):
        raise ValueError(
            f"MS-SSIM of {scales} scales needs sides above {(WINDOW - 1) << (scales - 1)} pixels, "
            f"found {h} x {w}, which allow {max_scales(h, w)}; see MS_SSIM.at(height, width)"
        )
    truth = display(reference)
    shown = torch.where(nonfinite_mask(image), (truth < 0.5).to(truth.dtype), display(image))
    if scales == len(SCALE_WEIGHTS):
        return _five_scales(shown, truth)
    return _fewer_scales(shown, truth, scales)


def max_scales(height: int, width: int) -> int:
    """Scales of MS-SSIM, at most 5, whose coarsest image still holds a whole window; maybe 0."""
    room = (min(height, width) - 1) // (WINDOW - 1)
    return min(room.bit_length(), len(SCALE_WEIGHTS))


def relmse(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Squared error of linear radiance over (reference squared + 1e-2), mean of pixels, channels.

    Relative squared error after Rousselle et al. 2011, for each channel by itself. Values are
    taken within the range of half floats, and a pixel that is not finite as the worst of these.
    """
    truth = _held(reference)
    error = (_held(image) - truth).square() / (truth.square() + RELMSE_EPS)
    return error.flatten(1).mean(1).float()


def mse_debiased(
    image: Float[Tensor, "n 3 h w"], a: Float[Tensor, "n 3 h w"], b: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """mean((x - a)(x - b)): squared error against the truth that two noisy halves estimate.

    Linear radiance, not clipped to the display, for clipping would bias it. Unbiased where a and b
    are independent, so it may fall below zero when the error is smaller than the reference's noise.
    Values beyond half floats and broken pixels are treated as in `relmse`.
    """
    held = _held(image)
    return ((held - _held(a)) * (held - _held(b))).flatten(1).mean(1).float()


def bias(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """How much too bright the whole image is, in percent of the reference; negative: too dark.

    100 (mean(x) - mean(r)) / mean(r) of linear radiance over pixels and channels. What noise adds
    is zero on average; what remains is light that a method makes up or loses, as when it averages
    the samples that also decided where to sample. Values beyond half floats and broken pixels are
    treated as in `relmse`; the mean of a reference counts as at least 1e-4.
    """
    truth = _held(reference).flatten(1).mean(1)
    error = _held(image).flatten(1).mean(1) - truth
    return (100 * error / truth.clamp_min(DARKEST)).float()


def nonfinite(image: Float[Tensor, "n 3 h w"]) -> Float[Tensor, " n"]:
    """Number of pixels in which some channel is NaN or infinite."""
    return nonfinite_mask(image).flatten(1).sum(1).float()


def nonfinite_mask(image: Float[Tensor, "n 3 h w"]) -> Bool[Tensor, "n 1 h w"]:
    """True where some channel of a pixel is NaN or infinite."""
    return ~torch.isfinite(image).all(1, keepdim=True)


def _held(image: Tensor) -> Tensor:
    """The image in the range of half floats, in double precision so that its square is finite."""
    return image.double().clamp(-LARGEST, LARGEST).masked_fill(nonfinite_mask(image), -LARGEST)


def _five_scales(shown: Tensor, truth: Tensor) -> Tensor:
    from pytorch_msssim import ms_ssim as engine

    score: Tensor = engine(shown, truth, data_range=1.0, size_average=False)
    return score


def _fewer_scales(shown: Tensor, truth: Tensor, scales: int) -> Tensor:
    """The engine's own SSIM at each scale, as the engine's MS-SSIM refuses fewer than five."""
    from pytorch_msssim import ssim

    n = shown.shape[0]
    x, y = shown.flatten(0, 1).unsqueeze(1), truth.flatten(0, 1).unsqueeze(1)  # n*3 1 h w
    share = math.fsum(SCALE_WEIGHTS) / math.fsum(SCALE_WEIGHTS[:scales])
    score = torch.ones_like(x[:, 0, 0, 0])
    for scale, weight in enumerate(SCALE_WEIGHTS[:scales]):
        k1 = 0.01 if scale == scales - 1 else NO_LUMINANCE  # luminance counts at the coarsest only
        term = ssim(x, y, data_range=1.0, size_average=False, K=(k1, 0.03))
        score = score * term.clamp_min(0) ** (weight * share)
        odd = [side % 2 for side in x.shape[2:]]
        x, y = F.avg_pool2d(x, 2, padding=odd), F.avg_pool2d(y, 2, padding=odd)
    return score.view(n, 3).mean(1)
