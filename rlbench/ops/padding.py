"""Odd sizes: pad an image to a multiple, crop it back."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F


def pad(image: Float[Tensor, "n c h w"], to: int) -> Float[Tensor, "n c h2 w2"]:
    """The image, its border repeated to the right and down until both sides divide by `to`."""
    h, w = image.shape[-2:]
    right, down = -w % to, -h % to
    return F.pad(image, (0, right, 0, down), mode="replicate") if right or down else image


def crop(image: Float[Tensor, "n c h w"], h: int, w: int) -> Float[Tensor, "n c h2 w2"]:
    """The top left h x w pixels: what `pad` was given."""
    return image[..., :h, :w]
