"""The table of variants: one frozen Config a row, one changed field for each question."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from rlbench.ops.unet import BASE_WIDTHS as NORMAL
from rlbench.ops.unet import FAST_WIDTHS, UNetWidths

__all__ = ["LATENT", "OURS", "SLOTS", "VARIANTS", "Config"]

DOUBLE = UNetWidths(64, 96, 128, 160, 192, (224, 224), (192, 192), (128, 128), (128, 64))
SLOTS = 8  # samples per pixel that the encoder can read one by one

EncodingName = Literal["single", "mean", "mean and count", "none"]
HistoryMode = Literal["state", "samples", "nothing"]
Accumulation = Literal["temporal", "rule", "frame", "none"]
LossName = Literal["l1_ms_ssim", "display"]
DenoiserStart = Literal["intel", "tuned"]
DensityName = Literal["exponential", "linear"]


@dataclass(frozen=True)
class Config:
    """The settings of a variant, by default of `ours/latent`, as in model cards and results.

    `methods.ours.method.assemble` turns them into parts, `methods.ours.networks` into channels.
    """

    sample_encoding: EncodingName = "single"  # how samples enter the encoder
    latent: int = 32  # channels of the recurrent state
    history_mode: HistoryMode = "state"  # recurrent input: latent, last samples (sampler only)
    accumulation: Accumulation = "temporal"  # radiance that the denoiser reads beside the state
    sampler: tuple[int, ...] = (4, 8, 16, 32)  # channels of the sampler's levels; empty: uniform
    sampler_stride: int = 1  # side in pixels of the blocks that the sampler reads the mean of
    density: DensityName = "exponential"  # density as a function of the action in [-1, 1]
    encoder: tuple[int, ...] = (64,)  # channels of the hidden layers; empty: no encoder
    encoder_kernel: int = 3  # pixels, side of the encoder's kernels
    denoiser: UNetWidths = NORMAL
    denoiser_start: DenoiserStart = "intel"  # first weights: Intel's, or those of oidn/tuned
    kernel_taps: int = 0  # of kernels that the denoiser predicts, if it writes the latent
    bptt: int = 1  # frames that gradients flow back through (truncated backpropagation)
    loss: LossName = "l1_ms_ssim"  # in log transfer; or squared error on the display
    log_loss: bool = True  # train on the logarithm of the loss?
    learner: str = "reinforce+surrogate"  # trains the sampler: a name of methods.ours.policy
    gamma: float = 0.0  # discount per frame of later errors that a map is credited with
    wired_contrast: bool = True  # do the sampler's first weights show it local contrast?
    ignore_density: bool = False  # sample uniformly in place of the sampler's density?
    contrast_density: bool = False  # multiply the density by that of the contrast rule?
    antilag: bool = True  # reduce history where new samples contradict it?

    @property
    def accumulates(self) -> bool:
        """Does the variant accumulate radiance over frames?"""
        return self.accumulation in ("temporal", "rule")

    @property
    def denoiser_writes_latent(self) -> bool:
        """Is the latent an output of the denoiser, in place of the encoder's?"""
        return self.accumulation == "rule"

    @property
    def for_training(self) -> Config:
        """The same variant without antilag: no light is switched in training clips."""
        return replace(self, antilag=False)


LATENT = Config()  # the networks of the paper, from Intel's weights, beside accumulated radiance
OURS = replace(  # rules where they are as good: for accumulation, and as a start of the density
    LATENT,
    sample_encoding="none",
    latent=0,
    encoder=(),
    accumulation="rule",
    sampler_stride=2,
    contrast_density=True,
)
PAPER = replace(  # the paper's recipe: the denoiser reads the state alone, rewards are discounted
    LATENT,
    accumulation="none",
    density="linear",
    log_loss=False,
    learner="reinforce",
    gamma=0.99,
    wired_contrast=False,
)
VARIANTS = {
    "": OURS,
    "A1": replace(OURS, learner="surrogate"),  # is the surrogate gradient alone as good?
    "A2": replace(OURS, sampler=(), contrast_density=False),  # is adaptive sampling worth its time?
    # what does the learned correction give over a rule of three lines?
    "by-rule": replace(OURS, ignore_density=True),
    # what does the density give, all else equal?
    "flat": replace(OURS, ignore_density=True, contrast_density=False),
    "lag": replace(OURS, antilag=False),  # what does antilag give?
    # what do the paper's encoder and recurrent state give over the rules?
    "latent": LATENT,
    "latent-A1": replace(LATENT, learner="surrogate"),
    "latent-A2": replace(LATENT, sampler=()),
    "latent-reinforce": replace(LATENT, learner="reinforce"),  # is REINFORCE alone enough?
    # does a difference over the next sample train as well as trials of whole maps?
    "latent-stochastic": replace(LATENT, learner="stochastic"),
    # does the recurrent state pay? the sampler still reads the last frame's samples
    "latent-B1": replace(LATENT, encoder=(), history_mode="samples", accumulation="frame"),
    # does any history pay?
    "latent-B2": replace(LATENT, encoder=(), history_mode="nothing", accumulation="frame"),
    "latent-C": replace(LATENT, sample_encoding="mean"),  # do individual samples pay?
    "latent-C+count": replace(LATENT, sample_encoding="mean and count"),  # or is it their number?
    # three at once
    "latent-small": replace(LATENT, sampler=(1, 2), encoder_kernel=1, denoiser=FAST_WIDTHS),
    # what does training give? the networks before their first step, which sample uniformly
    "latent-initial": replace(LATENT, sampler=()),
    # what does the learned density give over a rule of three lines?
    "latent-by-rule": replace(LATENT, ignore_density=True, contrast_density=True),
    # what does the latent give beside accumulated radiance and the last image?
    "latent-stateless": replace(LATENT, latent=0),
    "latent-flat": replace(LATENT, ignore_density=True),
    "latent-lag": replace(LATENT, antilag=False),
    "latent-sampler-small": replace(LATENT, sampler=(1, 2)),  # is one level enough?
    # does a full U-Net pay?
    "latent-sampler-large": replace(LATENT, sampler=(64, 128, 256, 512, 1024)),
    "latent-encoder-small": replace(LATENT, encoder_kernel=1),  # does it need neighbours?
    "latent-encoder-large": replace(LATENT, encoder=(64, 64, 64)),  # do two more layers pay?
    "latent-denoiser-small": replace(LATENT, denoiser=FAST_WIDTHS),  # is OIDN's fast one enough?
    "latent-denoiser-large": replace(LATENT, denoiser=DOUBLE),  # does twice the width pay?
    "paper": PAPER,  # does the paper's own recipe work, with credit for each block of pixels?
    "paper-appo": replace(PAPER, learner="appo"),  # and with one policy over the image?
    # the paper's ablations of its recipe; without a reward, or a memory, later frames do not count
    "paper-A1": replace(PAPER, learner="surrogate", gamma=0.0),
    "paper-A2": replace(PAPER, sampler=()),
    "paper-B1": replace(PAPER, encoder=(), history_mode="samples"),
    "paper-B2": replace(PAPER, encoder=(), history_mode="nothing", gamma=0.0),
    "paper-C": replace(PAPER, sample_encoding="mean"),
}
