"""How OIDN learns from the ReSTIR pool: as it learns from paths."""

from __future__ import annotations

import torch

from baselines.oidn.method import INPUTS, Oidn
from baselines.oidn.train import learning
from baselines.restir import DENOISED
from rlbench.ops.unet import UNet
from rlbench.training import Trainer


def trainer(variant: str, device: torch.device, seed: int) -> Trainer:
    """A seeded U-Net that learns as `baselines.oidn` does, on samples of the ReSTIR pool."""
    network = UNet(INPUTS, seed=seed).to(device)
    return learning(Oidn(network, DENOISED.variants[variant].traits))
