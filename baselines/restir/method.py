"""What is shown of the samples of the ReSTIR pool: their mean, or OIDN on it."""

from __future__ import annotations

from pathlib import Path

import torch

from baselines.mean import Mean
from baselines.oidn.method import INPUTS, Oidn
from baselines.restir import DENOISED, FAMILY
from rlbench.ops.unet import UNet
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"


def build(variant: str, device: torch.device, weights: str | None) -> Mean:
    """The mean of what was bought: S samples per pixel are S chains of reservoirs."""
    return Mean(FAMILY.variants[variant].traits)


def denoised(variant: str, device: torch.device, weights: str | None) -> Oidn:
    """OIDN as in `baselines.oidn`, with weights that were trained on this pool.

    Its noise is correlated between neighbours, who share samples, unlike that of paths.
    """
    network = UNet(INPUTS)
    load_for_inference(network, weights, CARDS / DENOISED.weights_file(variant), device)
    return Oidn(network, DENOISED.variants[variant].traits)
