"""Padding to a multiple of a network's stride, and cropping back, for images of any size."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

__all__ = ["crop", "pad"]


def pad(image: Float[Tensor, "n c h w"], multiple: int) -> Float[Tensor, "n c h2 w2"]:
    """The image, extended to the right and down so that both sides are multiples of a number.

    Border pixels are replicated. An image that already fits is returned unchanged.

    >>> import torch
    >>> pad(torch.zeros(1, 3, 9, 13), 8).shape
    torch.Size([1, 3, 16, 16])
    """
    h, w = image.shape[-2:]
    right, down = -w % multiple, -h % multiple
    return F.pad(image, (0, right, 0, down), mode="replicate") if right or down else image


def crop(image: Float[Tensor, "n c h w"], h: int, w: int) -> Float[Tensor, "n c h2 w2"]:
    """The top left h x w pixels; undoes `pad`."""
    return image[..., :h, :w]
