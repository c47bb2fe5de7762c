"""EAW (Dammertz 2010): an edge-avoiding a-trous wavelet filter on single frames."""

from __future__ import annotations

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(inputs=frozenset({"albedo", "normal", "depth"}), spp_range=(1.0, 8.0))

FAMILY = Family(
    name="eaw",
    title="Edge-avoiding a-trous wavelets",
    paper=(
        "Dammertz, Sewtz, Hanika, Lensch 2010, "
        "Edge-Avoiding A-Trous Wavelet Transform for fast Global Illumination Filtering"
    ),
    licence="Apache-2.0",
    variants={
        "": Variant("How far does a filter get without learning or history?", TRAITS, learned=False)
    },
    build="baselines.eaw.method:build",
)
