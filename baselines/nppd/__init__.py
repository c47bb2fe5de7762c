"""NPPD (Balint 2023): light is split over the levels of a pyramid, then splatted and summed."""

from __future__ import annotations

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(inputs=frozenset({"albedo", "normal", "depth", "motion"}), temporal=True)

FAMILY = Family(
    name="nppd",
    title="NPPD",
    paper=(
        "Balint, Wolski, Myszkowski, Seidel, Mantiuk 2023, "
        "Neural Partitioning Pyramids for Denoising Monte Carlo Renderings"
    ),
    licence="Apache-2.0",
    variants={
        "": Variant("How far does a filter get that splits light over scales?", TRAITS),
        "large": Variant("Do the published widths (15.6 M) gain?", TRAITS, pretrained=False),
        "history": Variant(
            "What do the rules of ours for history give? (weights of nppd)",
            TRAITS,
            weights_from="nppd",
        ),
    },
    build="baselines.nppd.method:build",
    train="baselines.nppd.train:training_task",
)
