"""One frame through OIDN: expose, transfer, pad, network, crop, inverse transfer, un-expose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from baselines.oidn import FAMILY, TRAITS
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.exposure import autoexposure
from rlbench.ops.padding import crop, pad
from rlbench.ops.transfer import HALF_MAX, pu_forward, pu_inverse
from rlbench.ops.unet import BASE_WIDTHS, FAST_WIDTHS, STRIDE, UNet, UNetWidths
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"
INPUTS = 9  # colour, albedo, normal

Expose = Callable[[Float[Tensor, "n 3 h w"]], Float[Tensor, "n 1 1 1"]]
Develop = Callable[[Float[Tensor, "n 3 h w"], Float[Tensor, "n 1 1 1"]], Float[Tensor, "n 3 h w"]]


@dataclass(frozen=True)
class Config:
    """What tells the variants apart."""

    widths: UNetWidths = BASE_WIDTHS  # channels of each convolution
    intel: bool = False  # does training start from Intel's weights?


VARIANTS = {
    "": Config(),
    "small": Config(widths=FAST_WIDTHS),  # is a third of the parameters enough?
    "tuned": Config(intel=True),  # what do our clips add to Intel's weights?
}


def inputs(exposed: Float[Tensor, "n 3 h w"], gbuffer: GBuffer) -> Float[Tensor, "n 9 h w"]:
    """What the network reads: exposed radiance in transfer space, albedo, normals in [0, 1]."""
    normal = gbuffer.normal.clamp(-1, 1) * 0.5 + 0.5
    return torch.cat((pu_forward(exposed), gbuffer.albedo.clamp(0, 1), normal), dim=1)


def to_radiance(
    value: Float[Tensor, "n 3 h w"], exposure: Float[Tensor, "n 1 1 1"]
) -> Float[Tensor, "n 3 h w"]:
    """What the network says, as linear radiance: clamped, out of transfer space, un-exposed.

    OIDN clamps below only; here also at the largest half float, so that the image stays finite.
    """
    return pu_inverse(value.clamp(0, 1)) / exposure


@dataclass(frozen=True)
class Oidn:
    """Afra 2019, Open Image Denoise: its ray-tracing filter for HDR with albedo and normal.

    The U-Net, the transfer function and the exposure are those of its training toolkit. The weights
    are ours, trained on the frames that every other method here is trained on; those of
    `oidn/tuned` start from Intel's. Differs from OIDN: borders are repeated, not zero, up to a
    multiple of 16.
    """

    network: nn.Module  # 9 channels to 3, in transfer space
    traits: Traits = TRAITS
    expose: Expose = field(default=autoexposure)  # noisy image to exposure
    develop: Develop = field(default=to_radiance)  # network's output and exposure to image

    def start(self, size: Size) -> None:
        """Nothing: every frame is its own."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform."""
        return torch.ones_like(gbuffer.albedo[:, :1])

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The image, from the mean of the samples, albedo and normal."""
        noisy = samples.mean.nan_to_num(0.0, HALF_MAX, 0.0).clamp_min(0)
        exposure = self.expose(noisy)
        seen = inputs(noisy * exposure, gbuffer)
        value = crop(self.network(pad(seen, multiple=STRIDE)), *seen.shape[-2:])
        return self.develop(value, exposure), None


def build(variant: str, device: torch.device, weights: str | None) -> Oidn:
    """OIDN with our weights, those of a file, or `"random"` ones."""
    network = UNet(INPUTS, widths=VARIANTS[variant].widths)
    load_for_inference(network, weights, CARDS / FAMILY.weights_file(variant), device)
    return Oidn(network)
