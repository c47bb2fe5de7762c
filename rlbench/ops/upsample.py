"""One step up a U-Net: a coarse level at twice its size, joined with a skip, and convolved."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F


class UpsampleConcatConv(nn.Conv2d):
    """A 3x3 convolution over a coarse level, doubled by nearest neighbour, and a skip beside it.

    The same parameters, and but for rounding the same output, as of a convolution of
    cat(interpolate(coarse, 2), skip). But in the doubled level neighbours are equal, so their
    weights are summed first: a transposed convolution of stride 2 with 4x4 of these sums takes 4
    products where 9 were, and neither the doubled level nor the joined one is ever written.
    """

    def __init__(self, coarse: int, skip: int, outputs: int, device: str | None = None) -> None:
        """Parameters for so many channels of either input."""
        super().__init__(coarse + skip, outputs, 3, padding=1, device=device)

    def forward(  # type: ignore[override]
        self, coarse: Float[Tensor, "n c h w"], skip: Float[Tensor, "n s 2*h 2*w"]
    ) -> Float[Tensor, "n o 2*h 2*w"]:
        """The convolution, at the size of `skip`."""
        raising, beside = torch.tensor_split(self.weight, [coarse.shape[1]], dim=1)
        raised = F.conv_transpose2d(
            coarse, as_transposed_kernel(raising), self.bias, stride=2, padding=1
        )
        return raised.add_(F.conv2d(skip, beside, padding=1))


def as_transposed_kernel(weight: Float[Tensor, "o c 3 3"]) -> Float[Tensor, "c o 4 4"]:
    """The kernel by which a transposed convolution does what `weight` does to a doubled image."""
    rows = F.pad(weight, (0, 0, 1, 0)) + F.pad(weight, (0, 0, 0, 1))
    both = F.pad(rows, (1, 0)) + F.pad(rows, (0, 1))
    return both.flip(2, 3).transpose(0, 1)
