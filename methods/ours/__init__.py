"""The proposed method: a reinforcement-learned sampler, a latent state and a denoiser on it."""

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth", "motion"}),
    adaptive=True,
    max_samples=8,  # the encoder has inputs for so many
    temporal=True,
)

UNIFORM = replace(TRAITS, adaptive=False)
STILL = replace(TRAITS, inputs=TRAITS.inputs - {"motion"}, temporal=False)
AT_LEAST_ONE = replace(
    TRAITS, min_samples=1, spp_range=(1.0, 8.0)
)  # the approximation divides by the count

FAMILY = Family(
    name="ours",
    title="RL-based stateful neural adaptive sampling and denoising",
    paper="Scardigli, Cavigelli, Müller 2023, RL-based Stateful Neural Adaptive Sampling and "
    "Denoising for Real-Time Path Tracing",
    licence="Apache-2.0",
    variants={
        "": Variant("Do learned sampling and a latent state pay?", TRAITS),
        "paper": Variant("What does the paper's own recipe reach, from random weights?", TRAITS),
        "A1": Variant("Does learning beat the gradient's approximation?", AT_LEAST_ONE),
        "A2": Variant("Is planning worth its time? (uniform sampling)", UNIFORM),
        "ppo": Variant(
            "Is trial and error enough, without the approximation?", TRAITS, pretrained=False
        ),
        "B1": Variant("Does the state pay? (only the sampler remembers, samples)", TRAITS),
        "B2": Variant("Does any memory pay? (every frame by itself)", STILL),
        "C": Variant("Do single samples pay? (their mean enters the encoder)", TRAITS),
        "C+count": Variant(
            "Is it the samples, or their number? (their mean and count)", TRAITS, pretrained=False
        ),
        "small": Variant("Are smaller networks enough? (all three)", TRAITS),
        "flat": Variant(
            "What does the map itself give? (weights of ours, sampled uniformly)",
            UNIFORM,
            weights_from="",
        ),
        "lag": Variant(
            "Does it pay to forget light that new samples contradict? (weights of ours)",
            TRAITS,
            weights_from="",
        ),
        "sampler-small": Variant("Is a sampler of one level enough?", TRAITS, pretrained=False),
        "sampler-large": Variant(
            "Does a sampler of the first U-Net's size pay?", TRAITS, pretrained=False
        ),
        "encoder-small": Variant(
            "Does the encoder need its neighbours? (1x1 kernels)", TRAITS, pretrained=False
        ),
        "encoder-large": Variant(
            "Do two more layers in the encoder pay?", TRAITS, pretrained=False
        ),
        "denoiser-small": Variant("Is OIDN's fast network enough?", TRAITS, pretrained=False),
        "denoiser-large": Variant(
            "Does a denoiser of twice the width pay?", TRAITS, pretrained=False
        ),
    },
    build="methods.ours.method:build",
    train="methods.ours.train:trainer",
)
