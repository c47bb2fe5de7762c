"""IMCD: a network draws features, and each pixel is averaged with those like it (Isik 2021)."""

from __future__ import annotations

from rlbench.family import Family, Traits, Variant

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth", "motion"}),
    temporal=True,
    spp_range=(1.0, 8.0),
)

FAMILY = Family(
    name="imcd",
    title="IMCD",
    paper=(
        "Işık, Mullia, Fisher, Eisenmann, Gharbi 2021, "
        "Interactive Monte Carlo Denoising using Affinity of Neural Features"
    ),
    licence="Apache-2.0",
    variants={
        "": Variant("How far do uniform samples get, each seen by itself and filtered?", TRAITS),
    },
    build="baselines.imcd.method:build",
    train="baselines.imcd.train:trainer",
)
