"""One frame through Intel's library, from the mean of the samples, albedo and normal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.oidn.sparse import FilledHoles
from baselines.oidn_intel import FAMILY, TRAITS
from baselines.oidn_intel.library import Filter, FilterSettings, library_version
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.fireflies import mean_without_fireflies

__all__ = ["VARIANTS", "Config", "OidnIntel", "build"]

get_filter = lru_cache(maxsize=4)(Filter)  # building a filter takes as long as running it


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants."""

    quality: str = "high"  # the library's default
    clean_aux: bool = False  # OIDN's cleanAux: albedo and normal are free of noise
    fills_holes: bool = False  # light of the neighbourhood where no sample is
    library_version: str = ""  # its version, which the results record


BASE = Config()
VARIANTS = {
    "": BASE,
    "balanced": replace(BASE, quality="balanced"),  # does it cost accuracy?
    "fast": replace(BASE, quality="fast"),  # does a smaller network cost accuracy?
    "filled": replace(BASE, fills_holes=True),  # does it work below 1 spp?
    "clean": replace(BASE, clean_aux=True),  # does declaring clean features help?
}


@dataclass(frozen=True)
class OidnIntel:
    """Open Image Denoise (Afra 2019): Intel's library, its ray-tracing filter and its weights.

    HDR colour with albedo and normal; uniform sampling, frames are independent. It runs on the CPU
    with as many threads as torch; tensors on another device are copied there and back. Differs
    from `baselines.oidn`: the library pads images with zeros to a multiple of 16, and processes
    large images in overlapping tiles. Fireflies are limited before the library sees them
    (rlbench.ops.limit_fireflies).
    """

    config: Config
    traits: Traits = TRAITS

    def start(self, size: Size) -> None:
        """No state: frames are independent."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.albedo[:, :1])

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The image in linear radiance; the clips of a batch one after another."""
        noisy = mean_without_fireflies(samples.radiance, samples.counts)
        settings = FilterSettings(self.config.quality, self.config.clean_aux)
        run_filter = get_filter(settings, *noisy.shape[-2:], torch.get_num_threads())
        inputs = zip(noisy, gbuffer.albedo.clamp(0, 1), gbuffer.normal.clamp(-1, 1), strict=True)
        return torch.stack([run_filter(*clip_inputs) for clip_inputs in inputs]), None


def build(variant: str, device: torch.device, weights: str | None) -> OidnIntel | FilledHoles:
    """The library with the settings of `variant` and its own weights."""
    method = OidnIntel(replace(VARIANTS[variant], library_version=library_version()))
    if method.config.fills_holes:
        return FilledHoles(method, FAMILY.variants[variant].traits)
    return method
