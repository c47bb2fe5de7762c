"""Open Image Denoise itself: Intel's library with Intel's weights, beside our retrained network."""

from __future__ import annotations

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

TRAITS = Traits(inputs=frozenset({"albedo", "normal"}), spp_range=(1.0, 8.0))
INTEL = Variant(
    "How far does the library get as it comes, trained by Intel on its own scenes?",
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
        "balanced": replace(INTEL, question="Does its middle quality cost anything?"),
        "fast": replace(INTEL, question="What does its network for previews cost?"),
        "clean": replace(INTEL, question="Does it help to say that albedo and normal are clean?"),
    },
    build="baselines.oidn_intel.method:build",
)
