"""Monte Carlo average: a path tracer's image without denoising, the lower end of every table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rlbench.family import Family, Traits, Variant

if TYPE_CHECKING:
    import torch
    from jaxtyping import Float
    from torch import Tensor

    from rlbench.frames import GBuffer, Samples, Size

TRAITS = Traits(receptive_field=0, spp_range=(0.0, 1024.0))  # as many as a clip can store

FAMILY = Family(
    name="mean",
    title="Monte-Carlo average",
    paper="Kajiya 1986, The Rendering Equation",
    licence="Apache-2.0",
    variants={"": Variant("How good are the samples alone?", TRAITS, learned=False)},
    build="baselines.mean:build",
)


@dataclass(frozen=True)
class Mean:
    """Uniform sampling, and the mean of each pixel's samples; black where a pixel has none."""

    traits: Traits = TRAITS

    def start(self, size: Size) -> None:
        """No state: frames are independent."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return samples.radiance.new_ones(samples.counts.shape)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The mean of each pixel's samples, linear radiance."""
        return samples.mean, None


def build(variant: str, device: torch.device, weights: str | None) -> Mean:
    """The only variant; it has no weights and runs on the device of its samples."""
    return Mean()
