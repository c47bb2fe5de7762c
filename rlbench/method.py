"""The contract: what a method is given, and what it returns."""

from __future__ import annotations

import json
from dataclasses import asdict, is_dataclass
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from rlbench.errors import PluginError
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size

State = Any  # opaque to the bench: returned by the method, carried to its next frame


@runtime_checkable
class Method(Protocol):
    """An adaptive sampler and a denoiser. Methods are frozen: what they remember is `state`."""

    @property
    def traits(self) -> Traits:
        """What it asks of the bench."""

    def start(self, size: Size) -> State:
        """The state before the first frame of a clip."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """Density: how much each pixel wants to be sampled, finite and >= 0, at any scale."""

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The image in linear radiance, and the state for the next frame."""


def checked_density(
    method: Method, gbuffer: GBuffer, samples: Samples, state: State
) -> Float[Tensor, "n 1 h w"]:
    """The density that a method plans.

    Raises PluginError where it varies though the traits say that the method does not adapt: of a
    stored clip it was then given no more samples than uniform sampling needs.
    """
    density = method.plan(gbuffer, samples, state)
    if not method.traits.adaptive and bool(density.max() > density.min()):
        raise PluginError("the density varies from pixel to pixel; declare Traits(adaptive=True)")
    return density


def config_json(method: Method) -> str:
    """A method's settings as JSON: those of its `config`, if it has one."""
    config: Any = getattr(method, "config", None)
    if not is_dataclass(config) or isinstance(config, type):
        return "{}"
    return json.dumps(asdict(config), default=repr, sort_keys=True)
