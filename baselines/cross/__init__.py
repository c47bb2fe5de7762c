"""Online cross-regression (Choi 2024): two halves of the samples teach a network in each frame."""

from __future__ import annotations

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth", "motion"}),
    temporal=True,
    min_samples=2,
    spp_range=(2.0, 8.0),
)

FAMILY = Family(
    name="cross",
    title="Online cross-regression",
    paper=(
        "Choi, Hong, Ha, Kang, Moon 2024, Online Neural Denoising with Cross-Regression for "
        "Interactive Rendering"
    ),
    licence="Apache-2.0",
    variants={
        "": Variant(
            "How far does a network get that learns on the frames it denoises?",
            TRAITS,
            learned=False,
        ),
        "pilots": Variant(
            "What does the regression give alone, without network and history?",
            replace(TRAITS, inputs=TRAITS.inputs - {"motion"}, temporal=False),
            learned=False,
        ),
        "frozen": Variant(
            "What does learning on this clip give? (weights of a pass over another clip)",
            TRAITS,
            learned=False,
        ),
        "contrast": Variant(
            "What does a density by the last image's contrast add?",
            replace(TRAITS, adaptive=True, max_samples=8),
            learned=False,
        ),
        "restir": Variant(
            "Does it gain from the samples of ReSTIR, which its authors use?",
            replace(TRAITS, pool="restir"),
            learned=False,
        ),
    },
    build="baselines.cross.method:build",
)
