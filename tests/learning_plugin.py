"""A plugin file with a method that learns one kernel, and whose loss a test can choose."""

from __future__ import annotations

from pathlib import Path

TEXT = """
from dataclasses import dataclass, field

import torch

from rlbench.family import Family, Traits, Variant
from rlbench.ops.init import kaiming_init
from rlbench.run import unroll
from rlbench.training import TrainingTask
from rlbench.weights import load_for_inference

TRAITS = Traits(spp_range=(1.0, 4.0))


@dataclass(frozen=True)
class Blur:
    net: torch.nn.Module = field(default_factory=lambda: torch.nn.Conv2d(3, 3, 3, padding=1))
    traits: Traits = TRAITS

    def start(self, size):
        return None

    def plan(self, gbuffer, samples, state):
        return torch.ones_like(samples.mean[:, :1])

    def denoise(self, gbuffer, samples, state):
        return self.net(samples.mean).float(), None


def build(variant, device, weights):
    method = Blur()
    kaiming_init(method.net)
    load_for_inference(method.net, weights, None, device)
    return method


def training_task(variant, device, seed):
    method, auxiliary = Blur(), AUXILIARY
    kaiming_init(method.net, seed)
    if auxiliary is not None:
        kaiming_init(auxiliary, seed)

    def losses(clip, spp):
        for step, result in enumerate(unroll(method, clip, spp)):
            loss = (result.image - result.frame.reference.mean).abs().mean()
            yield LOSS

    return TrainingTask(
        method, method.net, losses, (1.0, 2.0), MAX_LR, auxiliary_network=auxiliary
    )


ROWS = {"": Variant("?", TRAITS)}
FAMILY = Family("blur", "Blur", "Nobody 2026", "MIT", ROWS, "blur:build", "blur:training_task")
"""


def write_learner(
    folder: Path, loss: str = "loss", auxiliary: str = "None", max_lr: str = "1e-2"
) -> Path:
    """`blur.py`; `loss` is an expression of loss, step, clip, result and auxiliary."""
    file = folder / "blur.py"
    text = TEXT.replace("LOSS", loss).replace("AUXILIARY", auxiliary).replace("MAX_LR", max_lr)
    file.write_text(text)
    return file
