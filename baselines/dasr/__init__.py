"""DASR (Kuznetsov 2018): a network plans adaptive samples from one initial spp, one denoises."""

from __future__ import annotations

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth"}),
    adaptive=True,
    pilot_spp=1.0,
    min_samples=1,
    spp_range=(1.0, 8.0),
)
INTEL = replace(TRAITS, inputs=TRAITS.inputs - {"depth"})

FAMILY = Family(
    name="dasr",
    title="DASR",
    paper=(
        "Kuznetsov, Kalantari, Ramamoorthi 2018, "
        "Deep Adaptive Sampling for Low Sample Count Rendering"
    ),
    licence="Apache-2.0",
    variants={
        "": Variant("Does one sample per pixel show where the others should go?", TRAITS),
        "intel": Variant(
            "Does the pilot gain from an equal start? (U-Nets of oidn, Intel's weights)",
            INTEL,
            pretrained=False,
        ),
    },
    build="baselines.dasr.method:build",
    train="baselines.dasr.train:training_task",
)
