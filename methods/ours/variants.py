"""The table of variants: one frozen Config each, one changed field for each question."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from rlbench.ops.unet import BASE as NORMAL
from rlbench.ops.unet import FAST, Widths

DOUBLE = Widths(64, 96, 128, 160, 192, (224, 224), (192, 192), (128, 128), (128, 64))
SLOTS = 8  # individual samples that the encoder sees, per pixel
SAMPLES = {"single": 3 * SLOTS, "mean": 3, "mean and count": 4}  # channels

Remembered = Literal["state", "samples", "nothing"]
Light = Literal["gathered", "frame", "none"]
Density = Literal["exponential", "linear"]


@dataclass(frozen=True)
class Config:
    """What makes a variant. Channel counts follow from these (methods/ours/networks.py)."""

    samples: str = "single"  # how it sees them: a key of SAMPLES
    latent: int = 32  # channels of the state
    remembers: Remembered = "state"  # what of a frame the next one gets; samples: the sampler alone
    light: Light = "gathered"  # colour that the denoiser begins from: over frames, or one frame's
    sampler: tuple[int, ...] = (4, 8, 16, 32)  # widths of the sampler's levels; empty: uniform
    density: Density = "exponential"  # of its action, in [-1, 1]
    encoder: tuple[int, ...] = (64,)  # widths of its hidden layers; empty: no encoder
    kernel: int = 3  # side of the encoder's kernels
    denoiser: Widths = NORMAL
    bptt: int = 1  # frames through which gradients flow
    decibels: bool = True  # is the logarithm of the loss learned from?
    learner: str = "ppo-pixel+surrogate"  # how the sampler learns (methods/ours/policy)
    flat: bool = False  # is the sampler's map ignored?
    antilag: bool = True  # is light forgotten where new samples contradict it?

    @property
    def gathers(self) -> bool:
        """Is light remembered from frame to frame?"""
        return self.light == "gathered"

    @property
    def training(self) -> Config:
        """The same, as it trains: its clips switch no light, and nothing is forgotten."""
        return replace(self, antilag=False)


BASE = Config()
VARIANTS = {
    "": BASE,
    # the denoiser reads the state alone
    "paper": replace(BASE, light="none", density="linear", decibels=False, learner="ppo-pixel"),
    "A1": replace(BASE, learner="surrogate"),  # a gradient's approximation in place of learning
    "A2": replace(BASE, sampler=()),  # is planning worth its time?
    "ppo": replace(BASE, learner="ppo-pixel"),  # is trial and error enough?
    "B1": replace(BASE, encoder=(), remembers="samples", light="frame"),  # no state
    "B2": replace(BASE, encoder=(), remembers="nothing", light="frame"),  # and no feedback
    "C": replace(BASE, samples="mean"),  # samples averaged before the encoder
    "C+count": replace(BASE, samples="mean and count"),
    "small": replace(BASE, sampler=(1, 2), kernel=1, denoiser=FAST),
    "flat": replace(BASE, flat=True),  # what does the map give, all else equal?
    "lag": replace(BASE, antilag=False),  # what if light is never forgotten?
    "sampler-small": replace(BASE, sampler=(1, 2)),
    "sampler-large": replace(BASE, sampler=(64, 128, 256, 512, 1024)),
    "encoder-small": replace(BASE, kernel=1),
    "encoder-large": replace(BASE, encoder=(64, 64, 64)),
    "denoiser-small": replace(BASE, denoiser=FAST),
    "denoiser-large": replace(BASE, denoiser=DOUBLE),
}
