"""One frame through Intel's library: the mean of the samples, albedo and normal in, image out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.oidn_intel import TRAITS
from baselines.oidn_intel.library import Filter, Settings, library_version
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.transfer import HALF_MAX

filter_for = lru_cache(maxsize=4)(Filter)  # building one takes as long as using it


@dataclass(frozen=True)
class Config:
    """What tells the variants apart."""

    quality: str = "high"  # the library's default
    clean_aux: bool = False  # albedo and normal are claimed to be free of noise
    library_version: str = ""  # its version


BASE = Config()
VARIANTS = {
    "": BASE,
    "balanced": replace(BASE, quality="balanced"),  # does the middle quality cost anything?
    "fast": replace(BASE, quality="fast"),  # what does the network for previews cost?
    "clean": replace(BASE, clean=True),  # does it help to say that albedo and normal are clean?
}


@dataclass(frozen=True)
class OidnIntel:
    """Afra 2019, Open Image Denoise: the library, its ray-tracing filter and its weights.

    HDR colour with albedo and normal, one frame at a time. It runs on the processor, on as many
    threads as torch has; what lies on another device is copied there and back. Where the library's
    own rules differ from those of `baselines.oidn`: borders are zero up to a multiple of 16, and
    large images are cut into overlapping tiles.
    """

    config: Config
    traits: Traits = TRAITS

    def start(self, size: Size) -> None:
        """Nothing: every frame is its own."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform."""
        return torch.ones_like(gbuffer.albedo[:, :1])

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The image, from the mean of the samples, albedo and normal; clip by clip."""
        noisy = samples.mean.nan_to_num(0.0, HALF_MAX, 0.0).clamp_min(0)
        settings = Settings(self.config.quality, self.config.clean_aux)
        run = filter_for(settings, *noisy.shape[-2:], torch.get_num_threads())
        inputs = zip(noisy, gbuffer.albedo.clamp(0, 1), gbuffer.normal.clamp(-1, 1), strict=True)
        return torch.stack([run(*each) for each in inputs]), None


def build(variant: str, device: torch.device, weights: str | None) -> OidnIntel:
    """The library in one of its qualities, with the weights that it brings."""
    return OidnIntel(replace(VARIANTS[variant], library=library_version()))
