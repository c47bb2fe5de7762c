"""A method whose wrong returns are errors that say what was returned, and what to return.

Without it, the page that runs a method (rlbench.run) stops where it first uses what was returned,
with an error that names no line of the method.
"""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from rlbench.checks.returns import (
    Fault,
    WrongReturnError,
    describe_value,
    find_density_fault,
    find_return_fault,
)
from rlbench.frames import GBuffer, Samples
from rlbench.method import Method, State
from rlbench.registry.failure import point_at
from rlbench.wrappers import MethodWrapper

__all__ = ["CheckedReturns"]


@dataclass(frozen=True)
class CheckedReturns(MethodWrapper[Method]):
    """The wrapped method; types and shapes of its returns are checked, in a microsecond a frame.

    Values are not: a density is checked where samples are drawn, an image where it is scored.
    Raises WrongReturnError, which names the first line of the function.
    """

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The wrapped method's density, a tensor of a number per pixel."""
        density = super().plan(gbuffer, samples, state)
        if not isinstance(density, Tensor) or density.shape != samples.counts.shape:
            raise self._error("plan", find_density_fault(density, samples.counts.shape))
        return density

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The wrapped method's image, a tensor of the size of the frame, and the next state."""
        returned = super().denoise(gbuffer, samples, state)
        n, _, c, h, w = samples.radiance.shape
        if fault := find_return_fault(returned, n):
            raise self._error("denoise", fault)
        image, state = returned
        if image.shape != (n, c, h, w):
            found = f"denoise must return an image [{n} {c} {h} {w}], found {describe_value(image)}"
            fault = Fault(found, "support any size: pad and crop as in rlbench.ops (pad, crop)")
            raise self._error("denoise", fault)
        return image, state

    def _error(self, name: str, fault: Fault | None) -> WrongReturnError:
        assert fault is not None  # the caller has found it too
        error = WrongReturnError(*fault)
        point_at(error, getattr(self.method, name))
        return error
