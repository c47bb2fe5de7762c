"""The proposed method: a reinforcement-learned sampler, a latent state and a denoiser on it."""

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

TRAITS = Traits(
    needs=frozenset({"albedo", "normal", "depth", "motion"}),
    adapts=True,
    cap=8,  # the encoder has inputs for so many
    temporal=True,
)

FAMILY = Family(
    name="ours",
    title="RL-based stateful neural adaptive sampling and denoising",
    paper="Scardigli, Cavigelli, Müller 2023, RL-based Stateful Neural Adaptive Sampling and "
    "Denoising for Real-Time Path Tracing",
    licence="Apache-2.0",
    variants={
        "": Variant("Do learned sampling and a latent state pay?", TRAITS),
        "A2": Variant(
            "Is planning worth its time? (uniform sampling)", replace(TRAITS, adapts=False)
        ),
        "flat": Variant(
            "What does the map itself give? (weights of ours, sampled uniformly)",
            replace(TRAITS, adapts=False),
            borrows="",
        ),
    },
    build="methods.ours.method:build",
    train="methods.ours.train:trainer",
)
