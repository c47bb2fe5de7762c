"""The Monte-Carlo average: what a path tracer shows by itself, the floor of any table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rlbench.family import Family, Traits, Variant

if TYPE_CHECKING:
    import torch
    from jaxtyping import Float
    from torch import Tensor

    from rlbench.frames import GBuffer, Samples, Size

TRAITS = Traits()

FAMILY = Family(
    name="mean",
    title="Monte-Carlo average",
    paper="Kajiya 1986, The Rendering Equation",
    licence="Apache-2.0",
    variants={"": Variant("What does one get for the samples alone?", TRAITS, learned=False)},
    build="baselines.mean:build",
)


@dataclass(frozen=True)
class Mean:
    """Uniform sampling and the mean of what was bought; black where nothing was."""

    traits: Traits = TRAITS

    def start(self, size: Size) -> None:
        """Nothing is remembered."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Ones: every pixel wants the same."""
        return samples.radiance.new_ones(samples.counts.shape)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The mean of each pixel's samples, linear radiance."""
        return samples.mean, None


def build(variant: str, device: torch.device, weights: str | None) -> Mean:
    """The method; it has one variant, no weights, and runs wherever its samples lie."""
    return Mean()
