"""DASR: one sample a pixel shows where more are needed, a second network denoises (2018)."""

from __future__ import annotations

from rlbench.family import Family, Traits, Variant

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth"}),
    adaptive=True,
    pilot_spp=1.0,
    min_samples=1,
    spp_range=(1.0, 8.0),
)

FAMILY = Family(
    name="dasr",
    title="DASR",
    paper=(
        "Kuznetsov, Kalantari, Ramamoorthi 2018, "
        "Deep Adaptive Sampling for Low Sample Count Rendering"
    ),
    licence="Apache-2.0",
    variants={
        "": Variant("Does a first sample per pixel tell where the others should go?", TRAITS),
        "gamma": Variant("Does the map learn better from a smooth model of the samples?", TRAITS),
    },
    build="baselines.dasr.method:build",
    train="baselines.dasr.train:trainer",
)
