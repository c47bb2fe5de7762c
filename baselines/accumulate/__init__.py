"""Controls without learned memory or learned sampling: a denoiser on light accumulated by rule."""

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

__all__ = ["ADAPTIVE", "FAMILY", "TRAITS"]

TRAITS = Traits(inputs=frozenset({"albedo", "normal", "depth", "motion"}), temporal=True)
ADAPTIVE = replace(TRAITS, adaptive=True, max_samples=8)
DENOISER = "oidn/tuned"  # the method whose weights the controls use

FAMILY = Family(
    name="accumulate",
    title="Accumulation by rule, then OIDN",
    paper="Control: rules of Schied et al. 2017 and 2018, network of Áfra 2019",
    licence="Apache-2.0",
    variants={
        "": Variant(
            "What does a memory by rule give, sampled uniformly?", TRAITS, weights_from=DENOISER
        ),
        "contrast": Variant(
            "What does a density by the last image's contrast add?", ADAPTIVE, weights_from=DENOISER
        ),
        "variance": Variant(
            "What does a density by the samples' deviation add?", ADAPTIVE, weights_from=DENOISER
        ),
        "denoised-variance": Variant(
            "What does a density by the denoised image's deviation add?",
            ADAPTIVE,
            weights_from=DENOISER,
        ),
        "tuned": Variant(
            "Does the network gain by training on accumulated light? (contrast)", ADAPTIVE
        ),
        "intel": Variant(
            "What do rules give if nothing is trained here? (contrast)",
            ADAPTIVE,
            weights_from="oidn",
        ),
        "fast": Variant(
            "Is Intel's small network enough, trained on accumulated light? (contrast)", ADAPTIVE
        ),
    },
    build="baselines.accumulate.method:build",
    train="baselines.accumulate.train:training_task",
)
