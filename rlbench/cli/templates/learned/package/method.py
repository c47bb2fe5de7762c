"""A small network predicts a kernel for each pixel, which filters the samples around it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor, nn

from rlbench import GBuffer, Samples, Size, Traits, load_for_inference
from rlbench.ops import apply_kernels, kaiming_init, log_forward

from . import TRAITS

WEIGHTS = Path(__file__).parent / "cards" / "$name.safetensors"
SIDE = 5  # of a kernel, in pixels


def make_network(seed: int = 0) -> nn.Sequential:
    """Radiance, albedo and normal [n 9 h w] to the kernels' logits [n 25 h w]."""
    network = nn.Sequential(
        nn.Conv2d(9, 32, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(32, 32, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(32, SIDE * SIDE, 3, padding=1),
    )
    kaiming_init(network, seed)
    return network


@dataclass(frozen=True)
class KernelFilter:
    """Samples uniformly; its network is all that it learns."""

    network: nn.Module = field(default_factory=make_network)
    traits: Traits = TRAITS

    def start(self, size: Size) -> None:
        """Nothing is remembered from frame to frame."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Tensor:
        """A uniform density [n 1 h w]."""
        return torch.ones_like(samples.mean[:, :1])

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: None) -> tuple[Tensor, None]:
        """The filtered samples, in linear radiance [n 3 h w], and no state."""
        features = torch.cat((log_forward(samples.mean), gbuffer.albedo, gbuffer.normal), dim=1)
        kernels = self.network(features).float().softmax(dim=1)
        light = torch.cat((samples.mean * samples.counts, samples.counts), dim=1)
        filtered = apply_kernels(kernels, light)
        return filtered[:, :3] / filtered[:, 3:].clamp_min(1e-6), None


def build(variant: str, device: torch.device, weights: str | None) -> KernelFilter:
    """The method with trained weights, those of a file, or "random" ones."""
    method = KernelFilter()
    load_for_inference(method.network, weights, WEIGHTS, device)
    return method
