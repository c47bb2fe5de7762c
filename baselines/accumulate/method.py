"""One frame: reproject, reject, accumulate, fill holes, denoise by OIDN, blend, remember."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from baselines.accumulate import FAMILY
from baselines.accumulate.density import DENSITY_RULES, mix_with_uniform
from baselines.accumulate.memory import (
    History,
    Memory,
    accumulate_samples,
    empty_memory,
    reproject_memory,
    share_by_spp,
)
from baselines.oidn.method import CARDS as OIDN_CARDS
from baselines.oidn.method import INPUT_CHANNELS, run_network, to_radiance
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.accumulation import (
    AccumulatedRadiance,
    fill_holes,
    surface_features,
)
from rlbench.ops.asking import next_age
from rlbench.ops.exposure import autoexposure
from rlbench.ops.reprojection import ReprojectionMemo
from rlbench.ops.transfer import log_forward, log_inverse
from rlbench.ops.unet import UNet
from rlbench.ops.unet_widths import BASE_WIDTHS, FAST_WIDTHS, UNetWidths
from rlbench.weights import load_for_inference, load_into

CARDS = Path(__file__).parent / "cards"
BLEND = 0.3  # weight of the previous image, times surface similarity
CHANGE_RATE = 0.2  # weight of a frame in the mean change of the denoised image

Decode = Callable[[Float[Tensor, "n 3 h w"], Float[Tensor, "n 1 1 1"]], Float[Tensor, "n 3 h w"]]


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants."""

    density: str = ""  # a name in DENSITY_RULES; empty: uniform
    widths: UNetWidths = BASE_WIDTHS  # channels of each convolution


VARIANTS = {
    "": Config(),
    "contrast": Config(density="contrast"),
    "variance": Config(density="deviation"),
    "denoised-variance": Config(density="denoised deviation"),
    "tuned": Config(density="contrast"),
    "intel": Config(density="contrast"),
    "fast": Config(density="contrast", widths=FAST_WIDTHS),
}


@dataclass(frozen=True)
class Accumulate:
    """OIDN (Afra 2019) on radiance that fixed rules accumulate: a control for learned memories.

    The rules: bicubic reprojection; a weight that falls by 0.2 in each frame (Schied et al. 2017,
    Spatiotemporal Variance-Guided Filtering) and with the distance of normal, albedo and depth;
    rejection where new samples contradict the history (`rlbench.ops.antilag`, after Schied et al.
    2018); holes filled from their neighbourhood; 0.3 of the previous image blended in. Adaptive
    variants sample by a rule of `baselines.accumulate.density`. One constant was tuned, on preset
    `development` and others: how fast history fades with the surface (docs/development.md).
    """

    config: Config
    traits: Traits
    network: nn.Module  # 9 channels to 3, in transfer space
    decode: Decode = field(default=to_radiance)  # network output and exposure to image
    memo: ReprojectionMemo[History] = field(
        default_factory=ReprojectionMemo, repr=False, compare=False
    )

    def start(self, size: Size) -> Memory:
        """No history."""
        return empty_memory(size, next(self.network.parameters()).device)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: Memory) -> Float[Tensor, "n 1 h w"]:
        """The density of the rule; uniform without one, and in the first frame."""
        if not self.config.density or state.age == 0:
            return torch.ones_like(gbuffer.depth)
        history = self.memo.get(gbuffer, state, reproject_memory)
        return mix_with_uniform(DENSITY_RULES[self.config.density](history), history.similarity)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: Memory
    ) -> tuple[Float[Tensor, "n 3 h w"], Memory]:
        """The image in linear radiance, and the memory of it."""
        history = self.memo.get(gbuffer, state, reproject_memory)
        _, accumulated, history = accumulate_samples(samples, history)
        accumulated = fill_holes(accumulated, gbuffer.albedo)
        denoised = log_forward(self._run_network(gbuffer, accumulated))
        weight = self.blend_weight(denoised, history) * share_by_spp(samples.slot_spp)
        image = log_inverse(torch.lerp(denoised, history.image, weight))
        change = _update_change(history, denoised.detach())
        surface = surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)
        return image, Memory(accumulated, image, change, surface, next_age(state.age))

    def blend_weight(
        self, denoised: Float[Tensor, "n 3 h w"], history: History
    ) -> Float[Tensor, "n 1 h w"]:
        """Weight in [0, 1] of the last image, beside the new one in log transfer: by the rule."""
        return BLEND * history.similarity

    def _run_network(
        self, gbuffer: GBuffer, accumulated: AccumulatedRadiance
    ) -> Float[Tensor, "n 3 h w"]:
        """The denoised radiance of one frame, linear."""
        exposure = autoexposure(accumulated.mean.detach())
        output = run_network(self.network, accumulated.mean * exposure, gbuffer)
        return self.decode(output, exposure)


def build(variant: str, device: torch.device, weights: str | None) -> Accumulate:
    """The control with pretrained weights (None), those of a file (its path), or "random" ones."""
    config, declared = VARIANTS[variant], FAMILY.variants[variant]
    network = UNet(INPUT_CHANNELS, widths=config.widths)
    cards = OIDN_CARDS if declared.weights_from else CARDS
    load_for_inference(network, weights, cards / FAMILY.weights_file(variant), device)
    return Accumulate(config, declared.traits, network)


def _update_change(
    history: History, denoised: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, "n 1 h w"]:
    """The mean square of the change of the denoised image, with that of this frame; 0 if new."""
    change = (denoised - history.image).square().mean(1, keepdim=True)
    change = torch.where(
        history.change > 0, torch.lerp(history.change, change, CHANGE_RATE), change
    )
    return change.where(history.similarity > 0, 0.0)


def accumulated_network(widths: UNetWidths = BASE_WIDTHS) -> tuple[UNet, str]:
    """A network with the weights of the learned row of these widths, and their origin.

    Raises KeyError unless there is one.
    """
    network = UNet(INPUT_CHANNELS, widths=widths)
    row = {BASE_WIDTHS: "tuned", FAST_WIDTHS: "fast"}[widths]
    card = load_into(network, CARDS / FAMILY.weights_file(row))
    return network, f"{card.name}, from {card.origin}"
