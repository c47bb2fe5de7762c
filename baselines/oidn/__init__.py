"""OIDN: Open Image Denoise, a U-Net on single frames with uniform sampling.

The rows `oidn` and `oidn/fast` have the weights that Intel published; the others are trained here.
"""

from dataclasses import replace

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "HALF", "SPARSE", "TRAITS"]

TRAITS = Traits(inputs=frozenset({"albedo", "normal"}), spp_range=(1.0, 8.0))
SPARSE = replace(TRAITS, spp_range=(0.0, 8.0))
HALF = replace(SPARSE, inputs=TRAITS.inputs | {"depth"})

FAMILY = Family(
    name="oidn",
    title="Open Image Denoise",
    paper="Áfra 2019, Intel Open Image Denoise",
    licence="Apache-2.0 (reimplemented; weights by Intel, or trained here)",
    variants={
        "": Variant(
            "How far does a plain U-Net with Intel's weights get on uniform samples, without "
            "history?",
            TRAITS,
            trained_by="Intel",
        ),
        "fast": Variant(
            "What does Intel's small network, a third of the parameters, cost?",
            TRAITS,
            trained_by="Intel",
        ),
        "retrained": Variant("How far does the network get when trained on our clips?", TRAITS),
        "tuned": Variant("What does fine-tuning Intel's weights on our clips add?", TRAITS),
        "filled": Variant(
            "Does it work below 1 spp if holes are filled before it? (weights of tuned)",
            SPARSE,
            weights_from="oidn/tuned",
        ),
        "half": Variant(
            "Does half resolution gain below 1 spp? (joint upsampling, weights of tuned)",
            HALF,
            weights_from="oidn/tuned",
        ),
    },
    build="baselines.oidn.method:build",
    train="baselines.oidn.train:training_task",
)
