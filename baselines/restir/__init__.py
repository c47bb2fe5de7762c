"""ReSTIR DI (Bitterli 2020): direct light by reservoirs that neighbours and frames share.

The pool draws the samples. The method `restir` returns their mean, and `restir+oidn` denoises it.
"""

from rlbench.family import Family, Traits, Variant
from rlbench.pools import PoolKind

__all__ = ["DENOISED", "FAMILY", "POOL"]

POOL = PoolKind(
    name="restir",
    title="ReSTIR DI with path-traced indirect light, one chain of reservoirs an image",
    factory="baselines.restir.chains:biased",
    independent=False,
)

FAMILY = Family(
    name="restir",
    title="ReSTIR DI, biased, with path-traced indirect light",
    paper="Bitterli et al. 2020, Spatiotemporal reservoir resampling for real-time ray tracing",
    licence="Apache-2.0",
    variants={
        "": Variant(
            "How far do better direct-light samples get, without a denoiser?",
            Traits(pool=POOL.name, receptive_field=0),
            learned=False,
        )
    },
    build="baselines.restir.method:build",
)

DENOISED = Family(
    name="restir+oidn",
    title="ReSTIR DI, denoised by Open Image Denoise, retrained on it",
    paper="Bitterli et al. 2020 and Áfra 2019",
    licence="Apache-2.0 (reimplemented; our weights, started from Intel's)",
    variants={
        "": Variant(
            "Does a plain U-Net gain from better direct-light samples, despite correlation?",
            Traits(inputs=frozenset({"albedo", "normal"}), pool=POOL.name, spp_range=(1.0, 8.0)),
        )
    },
    build="baselines.restir.method:build_denoised",
    train="baselines.restir.train:training_task",
)
