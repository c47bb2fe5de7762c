"""OIDN: Open Image Denoise, a U-Net on single frames with uniform sampling, retrained by us."""

from rlbench.family import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(inputs=frozenset({"albedo", "normal"}), spp_range=(1.0, 8.0))

FAMILY = Family(
    name="oidn",
    title="Open Image Denoise, retrained",
    paper="Áfra 2019, Intel Open Image Denoise",
    licence="Apache-2.0 (reimplemented; our weights, those of `tuned` started from Intel's)",
    variants={
        "": Variant("How far does a plain U-Net get on uniform samples, without history?", TRAITS),
        "small": Variant("Is a third of the parameters enough?", TRAITS),
        "tuned": Variant("What does fine-tuning Intel's weights on our clips add?", TRAITS),
    },
    build="baselines.oidn.method:build",
    train="baselines.oidn.train:training_task",
)
