"""DASR's training loss: errors of colour and of edges, relative to the reference."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

__all__ = ["laplacian_of_gaussian", "relative_loss"]

EPS = 0.01  # added to the reference before dividing by it
SIGMA = 1.5  # of the Gaussian and of the Laplacian of Gaussian, pixels
RADIUS = 5  # of both filters, pixels: 11 taps


def relative_loss(
    image: Float[Tensor, "n c h w"], reference: Float[Tensor, "n c h w"]
) -> Float[Tensor, ""]:
    """Relative L1 error of colour plus relative L1 error of edges, weights 1 and 1.

    mean(|x - y| / (y + 0.01) + |edges(x) - edges(y)| / (y + 0.01)), where `laplacian_of_gaussian` is a Laplacian of
    Gaussian after a Gaussian. Image x and reference y are given as log(1 + L). Kuznetsov et al.
    2018, as in the training code behind `network.UNet`. Computed in float32, also under autocast.
    """
    with torch.autocast(image.device.type, enabled=False):
        difference, scale = (image - reference).float(), reference.float() + EPS
        # filters are linear: the difference of filtered images is the filtered difference
        error = laplacian_of_gaussian(difference).abs() + difference.abs()
        return (error / scale).mean()


def laplacian_of_gaussian(image: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h w"]:
    """Laplacian of Gaussian of the Gaussian-filtered image; zero beyond the border.

    Both filters have a sigma of 1.5 pixels and 11 x 11 taps; the second derivative is that of the
    Gaussian in closed form.
    """
    offset = torch.arange(-RADIUS, RADIUS + 1, device=image.device, dtype=image.dtype)
    gaussian = torch.softmax(-offset * offset / (2 * SIGMA**2), dim=0)
    second_derivative = gaussian * (offset * offset / SIGMA**4 - 1 / SIGMA**2)
    blurred = _separable_filter(image, gaussian, gaussian)
    return _separable_filter(blurred, second_derivative, gaussian) + _separable_filter(
        blurred, gaussian, second_derivative
    )


def _separable_filter(image: Tensor, vertical: Tensor, horizontal: Tensor) -> Tensor:
    """Filter each channel along the columns, then along the rows."""
    n, c, h, w = image.shape
    planes = image.reshape(n * c, 1, h, w)
    planes = F.conv2d(planes, vertical.view(1, 1, -1, 1), padding=(RADIUS, 0))
    return F.conv2d(planes, horizontal.view(1, 1, 1, -1), padding=(0, RADIUS)).view(n, c, h, w)
