"""BMFR (Koskela 2019): blocks of accumulated light are fitted by features of the G-buffer."""

from __future__ import annotations

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth", "motion"}), temporal=True, spp_range=(1.0, 8.0)
)

FAMILY = Family(
    name="bmfr",
    title="BMFR",
    paper=(
        "Koskela, Immonen, Mäkitalo, Foi, Viitanen, Jääskeläinen, Kultala, Takala 2019, Blockwise "
        "Multi-Order Feature Regression for Real-Time Path-Tracing Reconstruction"
    ),
    licence="Apache-2.0",
    variants={
        "": Variant(
            "How far does a fit of G-buffer features get, without learning?", TRAITS, learned=False
        ),
        "filled": Variant(
            "Does it work below 1 spp if holes of the accumulated light are filled?",
            replace(TRAITS, spp_range=(0.0, 8.0)),
            learned=False,
        ),
    },
    build="baselines.bmfr.method:build",
)
