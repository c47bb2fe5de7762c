"""The method under test: built once, and run once for all checks that can share a run."""

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
from rlbench.checks.result import CheckResult
from rlbench.clips.header import BUFFER_CHANNELS
from rlbench.family import Traits
from rlbench.frames import Clip, Size
from rlbench.method import Method
from rlbench.run import FrameResult, run_clip
from rlbench.system import provenance

if TYPE_CHECKING:
    from rlbench.clips.in_memory import InMemoryClip

__all__ = ["MethodUnderTest", "RecordedRun"]

DEFAULT_SPP = 0.6  # samples per pixel: leaves pixels without a sample where the method allows it


@dataclass(frozen=True)
class RecordedRun:
    """The results of a clip that ran through the method, and the recording of the method."""

    frames: list[FrameResult]
    recording: RecordingMethod

    @property
    def images(self) -> list[Tensor]:
        """The image of each frame, [n 3 h w]."""
        return [frame.image for frame in self.frames]


@dataclass(frozen=True)
class MethodUnderTest:
    """The method `name` on a device; a learned one with random weights.

    Weights are random because no check concerns quality, and so that a method can be checked before
    it is trained.

    >>> MethodUnderTest("mean").default_spp
    0.6
    """

    name: str
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    size: Size = clips.ODD_SIZE  # of the frames of most checks
    small_size: Size = clips.SMALL_SIZE  # of checks in which the size does not matter
    results: dict[str, CheckResult] = field(  # so far, by name of the check
        default_factory=dict, compare=False, repr=False
    )

    @cached_property
    def traits(self) -> Traits:
        """The traits that the family declares."""
        return registry.get_variant(self.name).traits

    @cached_property
    def unavailable_reason(self) -> str | None:
        """Why the method cannot run on this machine, or None."""
        pool, pools = self.traits.pool, registry.list_plugins("pools")
        if pool not in pools:
            return f"needs the sample pool '{pool}'; installed pools: {', '.join(pools)}"
        if why := registry.import_error("pools", pool):
            return f"its sample pool '{pool}' cannot be imported: {why}"
        if missing := " ".join(
            provenance.missing_packages(registry.get_variant(self.name).requires)
        ):
            return f"needs {missing}, which is not installed: pip install {missing}"
        if unknown := self.traits.inputs - set(BUFFER_CHANNELS):
            return f"declares inputs that no clip has: {', '.join(sorted(unknown))}"
        return self._missing_import()

    @cached_property
    def method(self) -> Method:
        """The method. Raises any exception of its `build` function."""
        weights = "random" if registry.get_variant(self.name).learned else None
        return registry.load_method(self.name, self.device, weights)

    @property
    def default_spp(self) -> float:
        """The budget of most checks, in samples per pixel."""
        low, high = self.traits.spp_range
        return min(max(low, DEFAULT_SPP), high)

    @cached_property
    def default_run(self) -> RecordedRun:
        """The run that most checks inspect, or compare with another run."""
        return self.run(self.clip())

    def clip(self, n: int = 1) -> InMemoryClip:
        """A clip of the default size, or a batch of `n` clips."""
        return clips.make_clip(self.device, clips.SEED, self.size._replace(n=n))

    def small_clip(
        self, seed: int = clips.SEED, pool_spp: int = clips.POOL_SPP, static: bool = False
    ) -> InMemoryClip:
        """A clip of small frames."""
        return clips.make_clip(self.device, seed, self.small_size, pool_spp, static)

    def run(self, clip: Clip, spp: float | None = None) -> RecordedRun:
        """Run a whole clip through the method, at `spp` samples per pixel (None: `default_spp`)."""
        frames, recording = self.start_run(clip, spp)
        return RecordedRun(list(frames), recording)

    def start_run(
        self, clip: Clip, spp: float | None = None
    ) -> tuple[Iterator[FrameResult], RecordingMethod]:
        """An iterator that runs one frame per step, and the recording that it fills."""
        recording = RecordingMethod(self.method)
        return run_clip(recording, clip, self.default_spp if spp is None else spp), recording

    def _missing_import(self) -> str | None:
        """The ImportError of building the method, unless the method's own package raised it."""
        try:
            self.method  # noqa: B018 - cached if it can be built
        except ImportError as error:
            package = registry.load_family(self.name).build.partition(".")[0].partition(":")[0]
            if (error.name or "").partition(".")[0] != package:
                return f"{type(error).__name__}: {error}"
        except Exception:  # the check "built" reports any other exception
            return None
        return None
