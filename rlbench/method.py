"""The contract of a method: four members, called in the order start, plan, denoise."""

from __future__ import annotations

import json
from dataclasses import asdict, is_dataclass
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from rlbench.errors import PluginError
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.questions import Questions

__all__ = ["Method", "State", "checked_density", "config_json"]

State = Any  # opaque to the benchmark: returned by the method and passed to its next frame


@runtime_checkable
class Method(Protocol):
    """An adaptive sampler and a denoiser.

    A method is immutable (a frozen dataclass): everything that persists between frames is in
    `state`. It never changes its arguments in place. It computes on the device of its inputs, for
    any image size and any batch size n; clips of one batch do not affect each other.

    A method that averages its samples and samples uniformly, without a state:

    >>> import torch
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Mean:
    ...     traits: Traits = Traits()
    ...     def start(self, size):
    ...         return None
    ...     def plan(self, gbuffer, samples, state):
    ...         return torch.ones_like(samples.counts, dtype=torch.float32)
    ...     def denoise(self, gbuffer, samples, state):
    ...         return samples.mean, None
    >>> isinstance(Mean(), Method)
    True
    """

    @property
    def traits(self) -> Traits:
        """The method's requirements: G-buffer channels, pool, passes, and limits; constant."""

    def start(self, size: Size) -> State:
        """The state before the first frame of a clip of this size."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """Sampling density: finite and >= 0, at any scale; a zero density means uniform.

        Called once per pass. `samples` holds the pilot and earlier passes of this frame (often
        none), `state` comes from the previous frame. Counts follow the density as closely as the
        budget, `min_samples` and `max_samples` allow (rlbench.sampling). A method with
        Traits(adaptive=False) returns a constant.
        """

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The image in linear radiance, float32 and finite, and the state for the next frame.

        Called once per frame, after the last pass. `samples` holds the samples of all passes, or
        those of the last pass alone with Traits(discard_pilot=True). `state` is the same as in
        `plan`; it is opaque to the benchmark, which may store, copy and replay it.
        """


def checked_density(
    method: Method, gbuffer: GBuffer, samples: Samples, state: State, questions: Questions
) -> Float[Tensor, "n 1 h w"]:
    """The density that `method` plans, checked against its traits.

    Raises PluginError if the density varies although the traits declare adaptive=False, here or
    when `questions` are answered. For such a method only as many stored samples are decoded as
    uniform sampling needs.
    """
    density = method.plan(gbuffer, samples, state)
    if not method.traits.adaptive:
        questions.ask((density.max() > density.min())[None], _check_constant)
    return density


def _check_constant(answer: list[float]) -> None:
    """Raise PluginError if the answer is that a density varies."""
    if answer[0]:
        raise PluginError(
            "the density varies between pixels, but the traits say adaptive=False; "
            "declare Traits(adaptive=True) or return a constant"
        )


def config_json(method: Method) -> str:
    """The method's settings as JSON: the fields of its dataclass `config`, or {} without one."""
    config: Any = getattr(method, "config", None)
    if not is_dataclass(config) or isinstance(config, type):
        return "{}"
    return json.dumps(asdict(config), default=repr, sort_keys=True)
