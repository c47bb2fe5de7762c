"""A loose file with a method whose one kernel learns, and what a test wants of its losses."""

from __future__ import annotations

from pathlib import Path

TEXT = """
from dataclasses import dataclass, field

import torch

from rlbench.family import Family, Traits, Variant
from rlbench.ops.init import initialise
from rlbench.run import unroll
from rlbench.training.task import Trainer
from rlbench.weights import equip

TRAITS = Traits(spp=(1.0, 4.0))


@dataclass(frozen=True)
class Blur:
    net: torch.nn.Module = field(default_factory=lambda: torch.nn.Conv2d(3, 3, 3, padding=1))
    traits: Traits = TRAITS

    def start(self, size):
        return None

    def plan(self, view, samples, state):
        return torch.ones_like(samples.mean[:, :1])

    def denoise(self, view, samples, state):
        return self.net(samples.mean).float(), None


def build(variant, device, weights):
    made = Blur()
    initialise(made.net)
    equip(made.net, weights, None, device)
    return made


def trainer(variant, device, seed):
    made, aside = Blur(), ASIDE
    initialise(made.net, seed)
    if aside is not None:
        initialise(aside, seed)

    def losses(clip, spp):
        for step, shown in enumerate(unroll(made, clip, spp)):
            loss = (shown.image - shown.frame.reference.mean).abs().mean()
            yield LOSS

    return Trainer(made, made.net, losses, (1.0, 2.0), PEAK, aside=aside)


ROWS = {"": Variant("?", TRAITS)}
FAMILY = Family("blur", "Blur", "Nobody 2026", "MIT", ROWS, "blur:build", "blur:trainer")
"""


def write_learner(
    folder: Path, loss: str = "loss", aside: str = "None", peak: str = "1e-2"
) -> Path:
    """`blur.py`, whose loss of a step is the expression `loss` of loss, step, clip and aside."""
    file = folder / "blur.py"
    file.write_text(TEXT.replace("LOSS", loss).replace("ASIDE", aside).replace("PEAK", peak))
    return file
