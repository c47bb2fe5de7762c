"""A plugin with learning rates and losses of `oidn/tuned`, for the search of its training.

Command: rlbench train --plugin research/tuning_search.py -m 'oidn-tuning/*' --frames 2000
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from baselines.oidn import TRAITS
from baselines.oidn.method import CARDS, INPUT_CHANNELS, Oidn, to_signed_radiance
from baselines.oidn.train import fine_tuning_task
from rlbench.family import Family, Variant
from rlbench.frames import Clip
from rlbench.ops.losses import log_loss, log_transfer_loss
from rlbench.ops.unet import UNet
from rlbench.run import unroll
from rlbench.training.task import TrainingTask
from rlbench.weights import load_for_inference

RATES = {"1e-5": 1e-5, "2e-5": 2e-5, "4e-5": 4e-5, "8e-5": 8e-5, "16e-5": 16e-5}
LOSSES = ("pu", "log")  # transfer in which images are compared: OIDN's, or that of `ours`


def build(variant: str, device: torch.device, weights: str | None) -> Oidn:
    """The network with the weights of a file (its path), or "random" ones."""
    network = UNet(INPUT_CHANNELS)
    load_for_inference(network, weights, CARDS / FAMILY.weights_file(variant), device)
    return Oidn(network)


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """Fine-tuning from Intel's weights at the rate and with the loss that the variant names."""
    loss, _, rate = variant.partition("-")
    task = fine_tuning_task(Oidn(UNet(INPUT_CHANNELS).to(device)))
    if loss == "log":
        assert isinstance(task.method, Oidn)
        signed = replace(task.method, decode=to_signed_radiance)

        def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
            for result in unroll(signed, clip, spp):
                yield log_loss(log_transfer_loss(result.image, result.frame.reference.mean))

        task = replace(task, losses=losses)
    return replace(task, max_lr=RATES[rate])


FAMILY = Family(
    name="oidn-tuning",
    title="Learning rates and losses of oidn/tuned",
    paper="",
    licence="Apache-2.0",
    variants={
        f"{loss}-{rate}": Variant(f"How good is {loss} at {rate}?", TRAITS, pretrained=False)
        for loss in LOSSES
        for rate in RATES
    },
    build=f"{__name__}:build",
    train=f"{__name__}:training_task",
)
