"""Methods on the ReSTIR pool: the mean of its samples, and OIDN on that mean."""

from __future__ import annotations

from pathlib import Path

import torch

from baselines.mean import Mean
from baselines.oidn.method import INPUT_CHANNELS, Oidn
from baselines.restir import DENOISED, FAMILY
from rlbench.ops.unet import UNet
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"


def build(variant: str, device: torch.device, weights: str | None) -> Mean:
    """The mean of the pool's samples: S samples per pixel are S chains of reservoirs."""
    return Mean(FAMILY.variants[variant].traits)


def build_denoised(variant: str, device: torch.device, weights: str | None) -> Oidn:
    """OIDN as in `baselines.oidn`, with weights trained on this pool.

    Unlike path-traced samples, neighbouring pixels share samples, so their noise is correlated.
    """
    network = UNet(INPUT_CHANNELS)
    load_for_inference(network, weights, CARDS / DENOISED.weights_file(variant), device)
    return Oidn(network, DENOISED.variants[variant].traits)
