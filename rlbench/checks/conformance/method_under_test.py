"""One method under examination: built once, run once for all claims that can share a run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rlbench import registry
from rlbench.checks.conformance import clips
from rlbench.checks.conformance.recording import RecordingMethod
from rlbench.checks.result import Finding
from rlbench.clips.header import VIEWS
from rlbench.family import Traits
from rlbench.frames import Clip, Size
from rlbench.method import Method
from rlbench.run import FrameResult, run_clip
from rlbench.system import provenance

if TYPE_CHECKING:
    from rlbench.clips.in_memory import InMemoryClip

USUAL = 0.6  # samples per pixel: leaves pixels without one where the method allows that


@dataclass(frozen=True)
class Run:
    """A clip that went through the method, and what the method did meanwhile."""

    shown: list[FrameResult]
    watched: RecordingMethod

    @property
    def images(self) -> list[Tensor]:
        """Of each frame."""
        return [each.image for each in self.shown]


@dataclass(frozen=True)
class MethodUnderTest:
    """The method `name` on a device; a learned one with random weights.

    Weights are random because no claim is of quality, and because a method whose weights were not
    trained yet can be checked too.
    """

    name: str
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    size: Size = clips.ODD  # of the frames of most claims
    lesser: Size = clips.SMALL  # of those where size is not what is asked about
    told: dict[str, Finding] = field(default_factory=dict, compare=False, repr=False)  # by claim

    @cached_property
    def traits(self) -> Traits:
        """What its family declares."""
        return registry.variant(self.name).traits

    @cached_property
    def absent(self) -> str | None:
        """Why nothing can be told of it on this machine, or None."""
        if self.traits.pool not in registry.names("pools"):
            have = ", ".join(registry.names("pools"))
            return f"it buys from a '{self.traits.pool}' pool, of those installed here: {have}"
        if why := registry.import_error("pools", self.traits.pool):
            return f"its pool '{self.traits.pool}' cannot be had here: {why}"
        if lacking := " ".join(provenance.missing(registry.variant(self.name).requires)):
            return f"it needs {lacking}, which is not here: pip install {lacking}"
        if unknown := self.traits.inputs - set(VIEWS):
            return f"it reads {', '.join(sorted(unknown))}, which no clip of format v1 has"
        try:
            self.method  # noqa: B018 - kept where it can be built
        except ImportError as error:
            own = registry.family(self.name).build.partition(".")[0].partition(":")[0]
            if (error.name or "").partition(".")[0] != own:
                return f"{type(error).__name__}: {error}"
        except Exception:  # whatever else building raises is a finding
            return None
        return None

    @cached_property
    def method(self) -> Method:
        """The method. Raises what building it raises."""
        weights = "random" if registry.variant(self.name).learned else None
        return registry.method(self.name, self.device, weights)

    @property
    def budget(self) -> float:
        """The samples per pixel that most claims are tried at."""
        low, high = self.traits.spp_range
        return min(max(low, USUAL), high)

    @cached_property
    def default_run(self) -> Run:
        """The run that most claims look at, or compare another one with."""
        return self.run(self.world())

    def world(self, n: int = 1) -> InMemoryClip:
        """A world of usual size, or several at once."""
        return clips.world(self.device, clips.SEED, self.size._replace(n=n))

    def small(
        self, seed: int = clips.SEED, pool: int = clips.POOL, static: bool = False
    ) -> InMemoryClip:
        """A world of small frames."""
        return clips.world(self.device, seed, self.lesser, pool, static)

    def run(self, clip: Clip, spp: float | None = None) -> Run:
        """A whole clip through the method."""
        shown, watched = self.begun(clip, spp)
        return Run(list(shown), watched)

    def begun(
        self, clip: Clip, spp: float | None = None
    ) -> tuple[Iterator[FrameResult], RecordingMethod]:
        """A clip that goes through the method as its frames are asked for."""
        watched = RecordingMethod(self.method)
        return run_clip(watched, clip, self.budget if spp is None else spp), watched
