"""The proposed method: a learned sampler and denoiser, with a memory by rule or a latent state."""

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth", "motion"}),
    adaptive=True,
    max_samples=8,  # the encoder has input channels for this many
    temporal=True,
)

UNIFORM = replace(TRAITS, adaptive=False)
SINGLE_FRAME = replace(TRAITS, inputs=TRAITS.inputs - {"motion"}, temporal=False)
# the surrogate gradient divides by the count
AT_LEAST_ONE = replace(TRAITS, min_samples=1, spp_range=(1.0, 8.0))

FAMILY = Family(
    name="ours",
    title="RL-based stateful neural adaptive sampling and denoising",
    paper="Scardigli, Cavigelli, Müller 2023, RL-based Stateful Neural Adaptive Sampling and "
    "Denoising for Real-Time Path Tracing",
    licence="Apache-2.0",
    variants={
        "": Variant("Do a learned density and denoiser pay, behind a memory by rule?", TRAITS),
        "A1": Variant("Is the surrogate gradient alone as good?", AT_LEAST_ONE),
        "A2": Variant("Is adaptive sampling worth its time? (uniform sampling)", UNIFORM),
        "by-rule": Variant(
            "What does the learned density give over a rule? (density by contrast)",
            TRAITS,
            weights_from="ours",
        ),
        "flat": Variant(
            "What does the density map itself give? (weights of ours, sampled uniformly)",
            UNIFORM,
            weights_from="ours",
        ),
        "lag": Variant(
            "Does antilag pay? (weights of ours, history is never rejected)",
            TRAITS,
            weights_from="ours",
        ),
        "latent": Variant(
            "Do the paper's encoder and recurrent state pay, beside accumulated radiance?", TRAITS
        ),
        "latent-A1": Variant(
            "With the latent state, is the surrogate gradient alone as good?", AT_LEAST_ONE
        ),
        "latent-A2": Variant(
            "With the latent state, is adaptive sampling worth its time? (uniform sampling)",
            UNIFORM,
        ),
        "latent-reinforce": Variant(
            "Is REINFORCE enough, without the surrogate gradient?", TRAITS, pretrained=False
        ),
        "latent-stochastic": Variant(
            "Is the gradient through stochastic rounding as good?", TRAITS, pretrained=False
        ),
        "latent-B1": Variant(
            "Does the state pay? (history for the sampler only: the last samples)", TRAITS
        ),
        "latent-B2": Variant("Does any history pay? (every frame by itself)", SINGLE_FRAME),
        "latent-C": Variant("Do individual samples pay? (their mean enters the encoder)", TRAITS),
        "latent-C+count": Variant(
            "Is it the samples, or their number? (their mean and count)", TRAITS, pretrained=False
        ),
        "latent-small": Variant("Are smaller networks enough? (all three)", TRAITS),
        "latent-initial": Variant(
            "What does training give? (before the first step, sampled uniformly)",
            UNIFORM,
            learned=False,
        ),
        "latent-by-rule": Variant(
            "With the latent state, what does the learned density give over a rule?",
            TRAITS,
            weights_from="ours/latent",
        ),
        "latent-stateless": Variant(
            "What does the latent give beside accumulated radiance? (no latent)",
            TRAITS,
        ),
        "latent-flat": Variant(
            "With the latent state, what does the density map itself give? (sampled uniformly)",
            UNIFORM,
            weights_from="ours/latent",
        ),
        "latent-lag": Variant(
            "With the latent state, does antilag pay? (history is never rejected)",
            TRAITS,
            weights_from="ours/latent",
        ),
        "latent-sampler-small": Variant(
            "Is a sampler of one level enough?", TRAITS, pretrained=False
        ),
        "latent-sampler-large": Variant(
            "Does a sampler of the size of the first U-Net pay?", TRAITS, pretrained=False
        ),
        "latent-encoder-small": Variant(
            "Does the encoder need neighbouring pixels? (1x1 kernels)", TRAITS, pretrained=False
        ),
        "latent-encoder-large": Variant(
            "Do two more layers in the encoder pay?", TRAITS, pretrained=False
        ),
        "latent-denoiser-small": Variant(
            "Is OIDN's fast network enough?", TRAITS, pretrained=False
        ),
        "latent-denoiser-large": Variant(
            "Does a denoiser of twice the width pay?", TRAITS, pretrained=False
        ),
        "paper": Variant("What does the paper's own recipe reach, from random weights?", TRAITS),
        "paper-appo": Variant(
            "Does one policy over the image learn? (the paper's recipe, by APPO)",
            TRAITS,
        ),
        "paper-A1": Variant(
            "In the paper's recipe, is the surrogate gradient as good?",
            AT_LEAST_ONE,
        ),
        "paper-A2": Variant(
            "In the paper's recipe, is adaptive sampling worth its time? (uniform sampling)",
            UNIFORM,
        ),
        "paper-B1": Variant(
            "In the paper's recipe, does the encoder pay? (the sampler reads the last samples)",
            TRAITS,
        ),
        "paper-B2": Variant(
            "In the paper's recipe, does any history pay? (every frame by itself)",
            SINGLE_FRAME,
        ),
        "paper-C": Variant(
            "In the paper's recipe, do individual samples pay? (their mean enters the encoder)",
            TRAITS,
        ),
    },
    build="methods.ours.method:build",
    train="methods.ours.train:training_task",
)
