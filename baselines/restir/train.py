"""Train OIDN on the ReSTIR pool: fine-tune Intel's weights as `oidn/tuned` does on paths."""

from __future__ import annotations

import torch

from baselines.oidn.method import INPUT_CHANNELS, Oidn
from baselines.oidn.train import fine_tuning_task
from baselines.restir import DENOISED
from rlbench.ops.unet import UNet
from rlbench.training import TrainingTask


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """Intel's U-Net, fine-tuned on samples of the ReSTIR pool as `oidn/tuned` is on paths.

    Raises LibraryError if the extra `oidn` is not installed.
    """
    network = UNet(INPUT_CHANNELS, seed=seed).to(device)
    return fine_tuning_task(Oidn(network, DENOISED.variants[variant].traits))
