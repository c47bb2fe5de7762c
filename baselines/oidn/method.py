"""One frame through OIDN: expose, transfer, pad, U-Net, crop, inverse transfer, undo exposure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from baselines.oidn import FAMILY, TRAITS
from baselines.oidn.sparse import FilledHoles, HalfResolution
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.exposure import autoexposure
from rlbench.ops.fireflies import mean_without_fireflies
from rlbench.ops.padding import crop, pad
from rlbench.ops.transfer import LOG_SCALE, pu_forward, pu_inverse
from rlbench.ops.unet import STRIDE, UNet
from rlbench.ops.unet_widths import BASE_WIDTHS, FAST_WIDTHS, UNetWidths
from rlbench.weights import load_for_inference, load_into

CARDS = Path(__file__).parent / "cards"
INPUT_CHANNELS = 9  # colour, albedo, normal
MIN_RADIANCE = -0.5 / LOG_SCALE  # while training; log transfer is defined above twice this

EstimateExposure = Callable[[Float[Tensor, "n 3 h w"]], Float[Tensor, "n 1 1 1"]]
Decode = Callable[[Float[Tensor, "n 3 h w"], Float[Tensor, "n 1 1 1"]], Float[Tensor, "n 3 h w"]]


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants."""

    widths: UNetWidths = BASE_WIDTHS  # channels of each convolution
    starts_from_intel: bool = False  # training starts from Intel's weights
    below_one_spp: type[FilledHoles] | None = None  # how pixels without samples are handled


VARIANTS = {
    "": Config(),
    "fast": Config(widths=FAST_WIDTHS),  # what does Intel's small network cost?
    "retrained": Config(),  # how far does the network get with our training?
    "tuned": Config(starts_from_intel=True),  # what does fine-tuning Intel's weights add?
    "filled": Config(below_one_spp=FilledHoles),
    "half": Config(below_one_spp=HalfResolution),
}


def encode_inputs(exposed: Float[Tensor, "n 3 h w"], gbuffer: GBuffer) -> Float[Tensor, "n 9 h w"]:
    """The network's input: exposed radiance in transfer space, albedo, and normals in [0, 1]."""
    normal = gbuffer.normal.clamp(-1, 1) * 0.5 + 0.5
    return torch.cat((pu_forward(exposed), gbuffer.albedo.clamp(0, 1), normal), dim=1)


def to_radiance(
    value: Float[Tensor, "n 3 h w"], exposure: Float[Tensor, "n 1 1 1"]
) -> Float[Tensor, "n 3 h w"]:
    """Linear radiance from the network's output: clamp, inverse transfer, undo the exposure.

    OIDN clamps below only; here also at the largest half float, so that the image stays finite.
    """
    return pu_inverse(value.clamp(0, 1)) / exposure


def to_signed_radiance(
    value: Float[Tensor, "n 3 h w"], exposure: Float[Tensor, "n 1 1 1"]
) -> Float[Tensor, "n 3 h w"]:
    """`to_radiance` for training: not clamped at 0, where gradients would end."""
    return (pu_inverse(value.clamp_max(1)) / exposure).clamp_min(MIN_RADIANCE)


def run_network(
    network: nn.Module,
    exposed: Float[Tensor, "n 3 h w"],
    gbuffer: GBuffer,
    *more: Float[Tensor, "n _ h w"],
) -> Float[Tensor, "n c h w"]:
    """The network's output, in transfer space, for exposed radiance, albedo, normal, and `more`.

    In float32 also under autocast: in half precision the inverse transfer would overflow.
    """
    features = torch.cat((encode_inputs(exposed, gbuffer), *more), dim=1)
    return crop(network(pad(features, multiple=STRIDE)), *features.shape[-2:]).float()


@dataclass(frozen=True)
class Oidn:
    """Open Image Denoise (Afra 2019): its ray-tracing filter for HDR with albedo and normal.

    U-Net, transfer function and exposure are those of its training toolkit. The weights of `oidn`
    and `oidn/fast` are Intel's; `oidn/retrained` is trained on our clips from random weights,
    `oidn/tuned` from Intel's. Uniform sampling, frames are independent. With Intel's weights the
    image equals the library's within 1e-4 of each value if the sides are multiples of 16. Differs
    from OIDN: images are padded to a multiple of 16 by repeating the border, not with zeros, and
    fireflies are limited (rlbench.ops.limit_fireflies), which OIDN leaves to the renderer.
    """

    network: nn.Module  # 9 channels to 3, in transfer space
    traits: Traits = TRAITS
    estimate_exposure: EstimateExposure = field(default=autoexposure)  # from the noisy image
    decode: Decode = field(default=to_radiance)  # network output and exposure to image

    def start(self, size: Size) -> None:
        """No state: frames are independent."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.albedo[:, :1])

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The image in linear radiance, from the mean of the samples, albedo and normal."""
        noisy = mean_without_fireflies(samples.radiance, samples.counts)
        exposure = self.estimate_exposure(noisy)
        return self.decode(run_network(self.network, noisy * exposure, gbuffer), exposure), None


def build(variant: str, device: torch.device, weights: str | None) -> Oidn | FilledHoles:
    """OIDN with pretrained weights (None), those of a file (its path), or "random" ones."""
    config = VARIANTS[variant]
    network = UNet(INPUT_CHANNELS, widths=config.widths)
    load_for_inference(network, weights, CARDS / FAMILY.weights_file(variant), device)
    if config.below_one_spp is None:
        return Oidn(network)
    return config.below_one_spp(Oidn(network), FAMILY.variants[variant].traits)


def published_network(widths: UNetWidths = BASE_WIDTHS) -> tuple[UNet, str]:
    """A network with Intel's published weights, for training to start from, and their origin.

    Raises KeyError unless Intel publishes a network of these widths.
    """
    return _load_network({BASE_WIDTHS: "", FAST_WIDTHS: "fast"}[widths])


def tuned_network(widths: UNetWidths = BASE_WIDTHS) -> tuple[UNet, str]:
    """A network with the weights of `oidn/tuned`, and their origin. Raises KeyError as above."""
    network, origin = _load_network({BASE_WIDTHS: "tuned"}[widths])
    return network, f"oidn/tuned, from {origin}"


@torch.no_grad()
def widen(network: UNet, source: UNet) -> None:
    """Copy weights into a network of equal widths with more inputs, or another number of outputs.

    The weights of new inputs, which are the last ones, are zero: at first they have no effect.
    Those of new outputs stay as they are.
    """
    weights = source.state_dict()
    for name, weight in network.state_dict().items():
        known = weights[name][: len(weight)]
        shared = weight[: len(known)].zero_()
        shared[tuple(map(slice, known.shape))].copy_(known)


def _load_network(variant: str) -> tuple[UNet, str]:
    """A network with the shipped weights of a variant, and their origin."""
    network = UNet(INPUT_CHANNELS, widths=VARIANTS[variant].widths)
    card = load_into(network, CARDS / FAMILY.weights_file(variant))
    return network, card.origin
