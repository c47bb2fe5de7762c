"""SVGF (Schied 2017): temporal accumulation, then a wavelet filter guided by variance."""

from __future__ import annotations

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

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
        "": Variant("How far does a temporal filter get without learning?", TRAITS, learned=False),
        "falcor": Variant(
            "What does a longer history give, with Falcor's constants?", TRAITS, learned=False
        ),
    },
    build="baselines.svgf.method:build",
)
