"""The proposed method: a reinforcement-learned sampler, a recurrent state, a denoiser on both."""

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
        "": Variant("Do a learned sampler and a recurrent state pay?", TRAITS),
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
        "A1": Variant("Is the surrogate gradient alone as good?", AT_LEAST_ONE),
        "A2": Variant("Is adaptive sampling worth its time? (uniform sampling)", UNIFORM),
        "reinforce": Variant(
            "Is REINFORCE enough, without the surrogate gradient?", TRAITS, pretrained=False
        ),
        "stochastic": Variant(
            "Is the gradient through stochastic rounding as good?", TRAITS, pretrained=False
        ),
        "B1": Variant(
            "Does the state pay? (history for the sampler only: the last samples)", TRAITS
        ),
        "B2": Variant("Does any history pay? (every frame by itself)", SINGLE_FRAME),
        "C": Variant("Do individual samples pay? (their mean enters the encoder)", TRAITS),
        "C+count": Variant(
            "Is it the samples, or their number? (their mean and count)", TRAITS, pretrained=False
        ),
        "small": Variant("Are smaller networks enough? (all three)", TRAITS),
        "initial": Variant(
            "What does training give? (before the first step, sampled uniformly)",
            UNIFORM,
            learned=False,
        ),
        "by-rule": Variant(
            "What does the learned density give over a rule? (density by contrast)",
            TRAITS,
            weights_from="ours",
        ),
        "stateless": Variant(
            "What does the latent give beside accumulated radiance? (no latent)",
            TRAITS,
        ),
        "lean": Variant(
            "Do a memory by rule and a learned correction of the contrast rule suffice?",
            TRAITS,
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
        "sampler-small": Variant("Is a sampler of one level enough?", TRAITS, pretrained=False),
        "sampler-large": Variant(
            "Does a sampler of the size of the first U-Net pay?", TRAITS, pretrained=False
        ),
        "encoder-small": Variant(
            "Does the encoder need neighbouring pixels? (1x1 kernels)", TRAITS, pretrained=False
        ),
        "encoder-large": Variant(
            "Do two more layers in the encoder pay?", TRAITS, pretrained=False
        ),
        "denoiser-small": Variant("Is OIDN's fast network enough?", TRAITS, pretrained=False),
        "denoiser-large": Variant(
            "Does a denoiser of twice the width pay?", TRAITS, pretrained=False
        ),
    },
    aliases={"ppo": "reinforce"},  # its former name; its loss is not a proximal one
    build="methods.ours.method:build",
    train="methods.ours.train:training_task",
)
