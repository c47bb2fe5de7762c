"""Wrappers around a method: the base class, and half-precision inference."""

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

HALF_DTYPE = torch.bfloat16  # range of float32, 8 bits of significand
M = TypeVar("M", bound=Method)


@dataclass(frozen=True)
class MethodWrapper(Generic[M]):
    """A method that forwards every call to another method, like `gymnasium.Wrapper`.

    Subclass it and override the members that differ. A wrapper is itself a `Method`.

    >>> @dataclass(frozen=True)
    ... class Brighter(MethodWrapper[Method]):
    ...     def denoise(self, gbuffer, samples, state):
    ...         image, state = super().denoise(gbuffer, samples, state)
    ...         return 2 * image, state
    >>> from rlbench import registry
    >>> Brighter(registry.load_method("mean", torch.device("cpu"))).traits.adaptive
    False
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
        """The wrapped method's image, and the next state."""
        return self.method.denoise(gbuffer, samples, state)


@dataclass(frozen=True)
class HalfPrecision(MethodWrapper[Method]):
    """A method with convolutions and matrix products in `dtype`; density and image stay float32.

    torch.autocast keeps sums, norms and other precision-critical operations in float32. The method
    itself needs no change. Its state may hold tensors of `dtype`.
    """

    device: torch.device  # where the method computes
    dtype: torch.dtype = HALF_DTYPE

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The method's density, in float32."""
        with torch.autocast(self.device.type, self.dtype):
            return super().plan(gbuffer, samples, state).float()

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The method's image, in float32, and the next state."""
        with torch.autocast(self.device.type, self.dtype):
            image, state = super().denoise(gbuffer, samples, state)
        return image.float(), state
