"""OIDN by Intel: the library with Intel's weights, which `baselines.oidn` is compared with."""

from __future__ import annotations

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(
    inputs=frozenset({"albedo", "normal"}),
    spp_range=(1.0, 8.0),
    eager_reason="Intel's library runs its network outside of PyTorch",
)
INTEL = Variant(
    "How far does the library get with its own weights, trained by Intel on other scenes?",
    TRAITS,
    learned=False,  # by us
    requires=("pyoidn",),
)

FAMILY = Family(
    name="oidn-intel",
    title="Open Image Denoise by Intel",
    paper="Áfra 2019, Intel Open Image Denoise",
    licence="Apache-2.0 (Intel's library and weights; the binding pyoidn is MIT)",
    variants={
        "": INTEL,
        "balanced": replace(INTEL, question="Does quality 'balanced' cost accuracy?"),
        "fast": replace(INTEL, question="Does quality 'fast', a smaller network, cost accuracy?"),
        "filled": replace(
            INTEL,
            question="Does it work below 1 spp if holes are filled before it?",
            traits=replace(TRAITS, spp_range=(0.0, 8.0)),
        ),
        "clean": replace(INTEL, question="Does declaring albedo and normal noise-free help?"),
    },
    build="baselines.oidn_intel.method:build",
)
