"""IMCD (Isik 2021): filter with kernels from the affinity of learned per-pixel features."""

from __future__ import annotations

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal", "depth", "motion"}), temporal=True, spp_range=(1.0, 8.0)
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
        "": Variant("How far do affinity kernels get on uniform samples, read one by one?", TRAITS),
        "history": Variant(
            "What do the rules of ours for history give? (weights of imcd)",
            TRAITS,
            weights_from="imcd",
        ),
    },
    build="baselines.imcd.method:build",
    train="baselines.imcd.train:training_task",
)
