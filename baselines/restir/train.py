"""How OIDN learns from the ReSTIR pool: as it is tuned on paths."""

from __future__ import annotations

import torch

from baselines.oidn.method import INPUTS, Oidn
from baselines.oidn.train import tuning
from baselines.restir import DENOISED
from rlbench.ops.unet import UNet
from rlbench.training import TrainingTask


def trainer(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """Intel's U-Net, tuned on samples of the ReSTIR pool as `oidn/tuned` is on paths.

    Raises LibraryError where the extra `oidn` is not installed.
    """
    network = UNet(INPUTS, seed=seed).to(device)
    return tuning(Oidn(network, DENOISED.variants[variant].traits))
