"""SVGF: history and its variance guide an edge-avoiding wavelet filter (Schied 2017)."""

from __future__ import annotations

from rlbench.family import Family, Traits, Variant

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth", "motion"}), temporal=True, spp_range=(1.0, 8.0)
)

FAMILY = Family(
    name="svgf",
    title="SVGF",
    paper=(
        "Schied, Kaplanyan, Wyman, Patney, Chaitanya, Burgess, Liu, Dachsbacher, Lefohn, Salvi "
        "2017, Spatiotemporal Variance-Guided Filtering"
    ),
    licence="Apache-2.0",
    variants={
        "": Variant("How far does one get without learning, with memory?", TRAITS, learned=False),
        "falcor": Variant(
            "What does a longer memory give, with the constants of Falcor?", TRAITS, learned=False
        ),
    },
    build="baselines.svgf.method:build",
)
