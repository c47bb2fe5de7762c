"""EAW (Dammertz 2010): an edge-avoiding a-trous wavelet filter, on frames or on still pixels."""

from __future__ import annotations

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "STILL", "TRAITS"]

TRAITS = Traits(inputs=frozenset({"albedo", "normal", "depth"}), spp_range=(1.0, 8.0))
STILL = Traits(
    inputs=TRAITS.inputs | {"motion"},
    adaptive=True,
    temporal=True,
    max_samples=8,
    spp_range=(0.25, 8.0),  # below, holes in the first frame are wider than they are filled from
    receptive_field=17,  # 14 of three passes, 2 of filled holes, 1 of filtered albedo
)

FAMILY = Family(
    name="eaw",
    title="Edge-avoiding a-trous wavelets",
    paper=(
        "Dammertz, Sewtz, Hanika, Lensch 2010, "
        "Edge-Avoiding A-Trous Wavelet Transform for fast Global Illumination Filtering"
    ),
    licence="Apache-2.0",
    variants={
        "": Variant(
            "How far does a filter get without learning or history?", TRAITS, learned=False
        ),
        "still": Variant(
            "What is saved where nothing moves, if still pixels take turns at being sampled?",
            STILL,
            learned=False,
        ),
    },
    build="baselines.eaw.method:build",
)
