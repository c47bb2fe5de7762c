"""What DASR is trained on: errors of colour and of edges, relative to the reference."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

DARK = 0.01  # added to the reference before dividing by it
SIGMA = 1.5  # pixels, of the Gaussian before the edges and of their filter
REACH = 5  # pixels to either side: 11 taps


def relative_loss(
    image: Float[Tensor, "n c h w"], reference: Float[Tensor, "n c h w"]
) -> Float[Tensor, ""]:
    """Relative error of colour plus that of edges, weights 1 and 1; both in log(1 + L).

    Mean of |x - y| / (y + 0.01), and the same of x and y under a Gaussian and a Laplacian of it:
    Kuznetsov et al. 2018, as in the training code behind `network.UNet`. In float32, also under
    autocast.
    """
    with torch.autocast(image.device.type, enabled=False):
        difference, scale = (image - reference).float(), reference.float() + DARK
        # filters are linear, so the difference of filtered images is the filtered difference
        found = edges(difference).abs() + difference.abs()
        return (found / scale).mean()


def edges(image: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h w"]:
    """The Laplacian of Gaussian of a Gaussian-filtered image; zero beyond the border.

    Both of sigma 1.5 over 11x11 pixels, the derivative taken of the Gaussian itself.
    """
    at = torch.arange(-REACH, REACH + 1, device=image.device, dtype=image.dtype)
    smooth = torch.softmax(-at * at / (2 * SIGMA**2), dim=0)
    curved = smooth * (at * at / SIGMA**4 - 1 / SIGMA**2)
    blurred = _along(image, smooth, smooth)
    return _along(blurred, curved, smooth) + _along(blurred, smooth, curved)


def _along(image: Tensor, down: Tensor, across: Tensor) -> Tensor:
    """One filter down the columns, then one across the rows, channel by channel."""
    n, c, h, w = image.shape
    flat = image.reshape(n * c, 1, h, w)
    flat = F.conv2d(flat, down.view(1, 1, -1, 1), padding=(REACH, 0))
    return F.conv2d(flat, across.view(1, 1, 1, -1), padding=(0, REACH)).view(n, c, h, w)
