"""The proposed method: a learned sampler and denoiser, with a memory by rule or a latent state.

One table holds all variants: a question, the settings that answer it, and the traits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from rlbench.family import Family, Traits, Variant
from rlbench.ops.unet_widths import BASE_WIDTHS, FAST_WIDTHS, UNetWidths

__all__ = ["FAMILY", "LATENT", "OURS", "SLOTS", "TRAITS", "VARIANTS", "Config"]

SLOTS = 8  # samples per pixel that the encoder can read one by one

EncodingName = Literal["single", "mean", "none"]
HistoryMode = Literal["state", "samples", "nothing"]
Accumulation = Literal["temporal", "rule", "frame", "none"]
LossName = Literal["l1_ms_ssim", "display"]
DenoiserStart = Literal["intel", "tuned", "accumulated"]
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
    sampler_stride: Literal[1, 2] = 1  # side in pixels of the blocks whose means the sampler reads
    density: DensityName = "exponential"  # density as a function of the action in [-1, 1]
    encoder: tuple[int, ...] = (64,)  # channels of the hidden layers; empty: no encoder
    encoder_kernel: int = 3  # pixels, side of the encoder's kernels
    denoiser: UNetWidths = BASE_WIDTHS
    # first weights: Intel's, those of oidn/tuned, or those of the row of `accumulate` of its size
    denoiser_start: DenoiserStart = "intel"
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
        """True if the variant accumulates radiance over frames."""
        return self.accumulation in ("temporal", "rule")

    @property
    def denoiser_writes_latent(self) -> bool:
        """True if the latent is an output of the denoiser, in place of the encoder's."""
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

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth", "motion"}),
    adaptive=True,
    max_samples=SLOTS,
    temporal=True,
)
UNIFORM = replace(TRAITS, adaptive=False)
SINGLE_FRAME = replace(TRAITS, inputs=TRAITS.inputs - {"motion"}, temporal=False)
# the surrogate gradient divides by the count
AT_LEAST_ONE = replace(TRAITS, min_samples=1, spp_range=(1.0, 8.0))


def _row(
    question: str,
    base: Config,
    traits: Traits = TRAITS,
    learned: bool = True,
    pretrained: bool = True,
    weights_from: str | None = None,
    **changes: Any,
) -> tuple[Config, Variant]:
    """A row: the settings of `base` with `changes`, and the arguments of its `Variant`."""
    config = replace(base, **changes)
    traits = replace(traits, reads_each_sample=config.sample_encoding == "single")
    return config, Variant(question, traits, learned, pretrained, weights_from)


def _paper(question: str, traits: Traits = TRAITS, **changes: Any) -> tuple[Config, Variant]:
    return _row(f"In the paper's recipe, {question}", PAPER, traits, **changes)


NO_MEMORY: dict[str, Any] = {"encoder": (), "history_mode": "nothing"}
LAST_SAMPLES: dict[str, Any] = {"encoder": (), "history_mode": "samples"}
ROWS = {
    "": _row("Do a learned density and denoiser gain, behind a memory by rule?", OURS),
    "A1": _row("Is the surrogate gradient alone as good?", OURS, AT_LEAST_ONE, learner="surrogate"),
    "A2": _row(
        "Is adaptive sampling worth its time? (uniform sampling)",
        OURS,
        UNIFORM,
        sampler=(),
        contrast_density=False,
    ),
    "fast": _row(
        "Do they gain before Intel's small network too?",
        OURS,
        pretrained=False,
        denoiser=FAST_WIDTHS,
        denoiser_start="accumulated",
    ),
    "by-rule": _row(
        "What does the learned density give over a rule? (density by contrast)",
        OURS,
        weights_from="ours",
        ignore_density=True,
    ),
    "flat": _row(
        "What does the density map itself give? (weights of ours, sampled uniformly)",
        OURS,
        UNIFORM,
        weights_from="ours",
        ignore_density=True,
        contrast_density=False,
    ),
    "lag": _row(
        "Does antilag gain? (weights of ours, history is never rejected)",
        OURS,
        weights_from="ours",
        antilag=False,
    ),
    "latent": _row(
        "Do the paper's encoder and recurrent state gain, beside accumulated radiance?", LATENT
    ),
    "latent-A1": _row(
        "With the latent state, is the surrogate gradient alone as good?",
        LATENT,
        AT_LEAST_ONE,
        learner="surrogate",
    ),
    "latent-A2": _row(
        "With the latent state, is adaptive sampling worth its time? (uniform sampling)",
        LATENT,
        UNIFORM,
        sampler=(),
    ),
    "latent-B1": _row(
        "Does the state gain? (history for the sampler only: the last samples)",
        LATENT,
        accumulation="frame",
        **LAST_SAMPLES,
    ),
    "latent-B2": _row(
        "Does any history gain? (every frame by itself)",
        LATENT,
        SINGLE_FRAME,
        accumulation="frame",
        **NO_MEMORY,
    ),
    "latent-C": _row(
        "Do individual samples gain? (their mean enters the encoder)",
        LATENT,
        sample_encoding="mean",
    ),
    "latent-small": _row(
        "Are smaller networks enough? (all three)",
        LATENT,
        sampler=(1, 2),
        encoder_kernel=1,
        denoiser=FAST_WIDTHS,
    ),
    "latent-initial": _row(
        "What does training give? (before the first step, sampled uniformly)",
        LATENT,
        UNIFORM,
        learned=False,
        sampler=(),
    ),
    "latent-by-rule": _row(
        "With the latent state, what does the learned density give over a rule?",
        LATENT,
        weights_from="ours/latent",
        ignore_density=True,
        contrast_density=True,
    ),
    "latent-stateless": _row(
        "What does the latent give beside accumulated radiance? (no latent)", LATENT, latent=0
    ),
    "latent-flat": _row(
        "With the latent state, what does the density map itself give? (sampled uniformly)",
        LATENT,
        UNIFORM,
        weights_from="ours/latent",
        ignore_density=True,
    ),
    "latent-lag": _row(
        "With the latent state, does antilag gain? (history is never rejected)",
        LATENT,
        weights_from="ours/latent",
        antilag=False,
    ),
    "paper": _row("What does the paper's own recipe reach, from random weights?", PAPER),
    "paper-appo": _row(
        "Does one policy over the image learn? (the paper's recipe, by APPO)", PAPER, learner="appo"
    ),
    # without a reward, or a memory, later frames do not count: gamma is 0
    "paper-A1": _paper(
        "is the surrogate gradient as good?", AT_LEAST_ONE, learner="surrogate", gamma=0.0
    ),
    "paper-A2": _paper(
        "is adaptive sampling worth its time? (uniform sampling)", UNIFORM, sampler=()
    ),
    "paper-flat": _paper(
        "what does the density map itself give? (sampled uniformly)",
        UNIFORM,
        weights_from="ours/paper",
        ignore_density=True,
    ),
    "paper-B1": _paper(
        "does the encoder gain? (the sampler reads the last samples)", **LAST_SAMPLES
    ),
    "paper-B2": _paper(
        "does any history gain? (every frame by itself)", SINGLE_FRAME, gamma=0.0, **NO_MEMORY
    ),
    "paper-C": _paper(
        "do individual samples gain? (their mean enters the encoder)", sample_encoding="mean"
    ),
}
VARIANTS = {name: config for name, (config, _) in ROWS.items()}

FAMILY = Family(
    name="ours",
    title="RL-based stateful neural adaptive sampling and denoising",
    paper="Scardigli, Cavigelli, Müller 2023, RL-based Stateful Neural Adaptive Sampling and "
    "Denoising for Real-Time Path Tracing",
    licence="Apache-2.0",
    variants={name: variant for name, (_, variant) in ROWS.items()},
    build="methods.ours.method:build",
    train="methods.ours.train:training_task",
)
