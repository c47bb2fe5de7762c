"""NTAS (Hasselgren 2020): one network plans the samples, one predicts kernels that filter them."""

from __future__ import annotations

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth", "motion"}),
    adaptive=True,
    temporal=True,
    min_samples=1,
    spp_range=(1.0, 8.0),
)
INTEL = replace(TRAITS, inputs=TRAITS.inputs - {"depth"})

FAMILY = Family(
    name="ntas",
    title="NTAS",
    paper=(
        "Hasselgren, Munkberg, Salvi, Patney, Lefohn 2020, "
        "Neural Temporal Adaptive Sampling and Denoising"
    ),
    licence="Apache-2.0",
    variants={
        "": Variant("How far do predicted kernels and a map from the last frame get?", TRAITS),
        "direct": Variant("Are kernels needed, or does a colour per pixel do as well?", TRAITS),
        "history": Variant(
            "What do the rules of ours for history give? (weights of ntas)",
            TRAITS,
            weights_from="ntas",
        ),
        "intel": Variant(
            "Do the last image and its map gain from an equal start? (U-Nets of oidn, Intel's "
            "weights)",
            INTEL,
            pretrained=False,
        ),
    },
    build="baselines.ntas.method:build",
    train="baselines.ntas.train:training_task",
)
