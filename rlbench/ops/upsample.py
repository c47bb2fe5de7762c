"""A decoder step of a U-Net: upsample the coarse level, concatenate the skip, convolve."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from rlbench.ops.asking import is_recorded

__all__ = ["UpsampleConcatConv", "as_transposed_kernel"]


class UpsampleConcatConv(nn.Conv2d):
    """3 x 3 convolution of cat(interpolate(coarse, 2), skip), with nearest-neighbour upsampling.

    Has the parameters of that convolution and, up to rounding, its output. Neighbours are equal in
    the upsampled level, so their weights are summed first: a transposed convolution of stride 2
    with a 4 x 4 kernel of these sums needs 4 products instead of 9, and neither the upsampled nor
    the concatenated tensor is ever stored.
    """

    def __init__(
        self, coarse_channels: int, skip_channels: int, out_channels: int, device: str | None = None
    ) -> None:
        """Create the parameters of a 3 x 3 convolution of coarse_channels + skip_channels."""
        super().__init__(coarse_channels + skip_channels, out_channels, 3, padding=1, device=device)
        self.coarse_channels = coarse_channels
        # address and version of the weights, these weights, and the kernels
        self._kept: tuple[tuple[int, int], Tensor, tuple[Tensor, Tensor]] | None = None

    def forward(  # type: ignore[override]
        self, coarse: Float[Tensor, "n c h w"], skip: Float[Tensor, "n s 2*h 2*w"]
    ) -> Float[Tensor, "n o 2*h 2*w"]:
        """The convolution at the resolution of `skip`."""
        coarse_kernel, skip_kernel = self._kernels(coarse)
        upsampled = F.conv_transpose2d(coarse, coarse_kernel, self.bias, stride=2, padding=1)
        return upsampled.add_(F.conv2d(skip, skip_kernel, padding=1))

    def _kernels(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """The kernels of both parts; without gradients they are kept while the weights stay."""
        weight = self.weight
        is_traced = is_recorded(inputs) or torch._C._get_tracing_state() is not None
        if torch.is_grad_enabled() or is_traced or weight.is_inference():
            return self._make_kernels()
        source = weight.detach()  # kept too, so that no other weight takes its place in memory
        state = (source.data_ptr(), source._version)
        if self._kept is None or self._kept[0] != state:
            with torch.inference_mode(False), torch.no_grad():
                self._kept = state, source, self._make_kernels()
        return self._kept[2]

    def _make_kernels(self) -> tuple[Tensor, Tensor]:
        coarse, skip = torch.tensor_split(self.weight, [self.coarse_channels], dim=1)
        return as_transposed_kernel(coarse).contiguous(), skip.contiguous()


def as_transposed_kernel(weight: Float[Tensor, "o c 3 3"]) -> Float[Tensor, "c o 4 4"]:
    """Kernel of the transposed convolution that equals `weight` applied to an upsampled image."""
    rows = F.pad(weight, (0, 0, 1, 0)) + F.pad(weight, (0, 0, 0, 1))
    both = F.pad(rows, (1, 0)) + F.pad(rows, (0, 1))
    return both.flip(2, 3).transpose(0, 1)
