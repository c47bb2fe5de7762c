"""Open Image Denoise: a U-Net on the mean of the samples, one frame at a time, trained by us."""

from rlbench.family import Family, Traits, Variant

TRAITS = Traits(inputs=frozenset({"albedo", "normal"}), spp_range=(1.0, 8.0))

FAMILY = Family(
    name="oidn",
    title="Open Image Denoise, retrained",
    paper="Áfra 2019, Intel Open Image Denoise",
    licence="Apache-2.0 (reimplemented; the weights are ours, of `tuned` from Intel's)",
    variants={
        "": Variant("How far does a plain U-Net get on uniform samples, without memory?", TRAITS),
        "small": Variant("Is a third of the parameters enough?", TRAITS),
        "tuned": Variant("What do our clips add to Intel's weights?", TRAITS),
    },
    build="baselines.oidn.method:build",
    train="baselines.oidn.train:trainer",
)
