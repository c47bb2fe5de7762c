"""Methods around a method: the base of all wrappers, and networks in half precision."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.method import Method, State

__all__ = ["HalfPrecision", "MethodWrapper"]

DTYPE = torch.bfloat16  # range of float32, 8 bits of mantissa
M = TypeVar("M", bound=Method)


@dataclass(frozen=True)
class MethodWrapper(Generic[M]):
    """A method that passes every call on to another one, as `gymnasium.Wrapper` does.

    Subclass it and override what differs. A wrapper is itself a `Method`.
    """

    method: M

    @property
    def traits(self) -> Traits:
        """The wrapped method's traits."""
        return self.method.traits

    @property
    def config(self) -> Any:
        """The wrapped method's config, or None."""
        return getattr(self.method, "config", None)

    def start(self, size: Size) -> State:
        """The wrapped method's state before the first frame of a clip."""
        return self.method.start(size)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The wrapped method's density."""
        return self.method.plan(gbuffer, samples, state)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The wrapped method's image and next state."""
        return self.method.denoise(gbuffer, samples, state)


@dataclass(frozen=True)
class HalfPrecision(MethodWrapper[Method]):
    """The same method with convolutions and matrix products in bfloat16, images in float32.

    torch.autocast keeps sums, norms and other delicate operations in float32. The method itself
    needs no change. Its state may be bfloat16.
    """

    device: torch.device

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The method's density, in float32."""
        with torch.autocast(self.device.type, DTYPE):
            return super().plan(gbuffer, samples, state).float()

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The method's image, in float32, and its next state."""
        with torch.autocast(self.device.type, DTYPE):
            image, state = super().denoise(gbuffer, samples, state)
        return image.float(), state
