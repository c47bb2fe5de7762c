"""A method whose networks compute in half precision: what that saves, and what it costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.method import Method, State

DTYPE = torch.bfloat16  # range of float32, 8 bits of mantissa; what training's --half uses


@dataclass(frozen=True)
class HalfPrecision:
    """The same method; its convolutions and matrix products are in bfloat16, images in float32.

    By torch.autocast, which leaves sums, norms and everything else that is delicate in float32. A
    method need not know of it. What it remembers may be in bfloat16.
    """

    method: Method
    device: torch.device

    @property
    def traits(self) -> Traits:
        """Those of the method."""
        return self.method.traits

    @property
    def config(self) -> Any:
        """The method's settings, if it has any."""
        return getattr(self.method, "config", None)

    def start(self, size: Size) -> State:
        """As the method's."""
        return self.method.start(size)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """As the method's."""
        with torch.autocast(self.device.type, DTYPE):
            return self.method.plan(gbuffer, samples, state).float()

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """As the method's."""
        with torch.autocast(self.device.type, DTYPE):
            image, state = self.method.denoise(gbuffer, samples, state)
        return image.float(), state
