"""The method under test: built once, and run once for all checks that can share a run.

Clips are closed-form, in memory, and shared by all methods. Wrappers record what a method does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import torch
from torch import Tensor

from rlbench import registry
from rlbench.checks.frame_edits import to_clip
from rlbench.checks.result import CheckResult
from rlbench.clips.header import BUFFER_CHANNELS
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.family import Traits
from rlbench.frames import Clip, GBuffer, Samples, Size
from rlbench.method import Method, State
from rlbench.ops.nested_tensors import has_graph, is_bit_equal, iterate_tensors
from rlbench.returns import (
    Fault,
    WrongReturnError,
    find_density_fault,
    find_return_fault,
)
from rlbench.run import FrameResult, run_clip
from rlbench.system import provenance
from rlbench.wrappers import MethodWrapper

DEFAULT_SPP = 0.6  # samples per pixel: leaves pixels without a sample where the method allows it
POOL_SPP = 8  # samples per pixel in the pool
FRAMES = 3  # one without history, one with, and one whose history has a history
SEED, OTHER_SEED = 3, 8  # of two different clips
EVEN_SIZE = Size(1, 64, 96)  # divisible by the strides of all usual networks
ODD_SIZE = Size(1, 77, 123)  # neither side is divisible by any stride of a network
SMALL_SIZE = Size(1, 37, 53)  # odd as well, for checks in which the size does not matter
TINY_SIZE = Size(1, 9, 13)  # both sides below the 16 or 32 pixels that networks reduce to one


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
    size: Size = ODD_SIZE  # of the frames of most checks
    small_size: Size = SMALL_SIZE  # of checks in which the size does not matter
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
        requires = registry.get_variant(self.name).requires
        if missing := " ".join(provenance.missing_packages(requires)):
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
        return self.traits.nearest_spp(DEFAULT_SPP)

    @cached_property
    def default_run(self) -> RecordedRun:
        """The run that most checks inspect, or compare with another run."""
        return self.run(self.clip())

    def clip(self, size: Size | None = None, n: int = 1) -> InMemoryClip:
        """A clip of a size, or of the default one; a batch of `n` clips."""
        return _make_clip(self.device, SEED, (size or self.size)._replace(n=n))

    def small_clip(
        self, seed: int = SEED, pool_spp: int = POOL_SPP, static: bool = False
    ) -> InMemoryClip:
        """A clip of small frames."""
        return _make_clip(self.device, seed, self.small_size, pool_spp, static)

    def run(self, clip: Clip, spp: float | None = None) -> RecordedRun:
        """Run a whole clip through the method, at `spp` samples per pixel (None: `default_spp`)."""
        recording = RecordingMethod(self.method)
        return RecordedRun(list(self.run_with(recording, clip, spp)), recording)

    def run_with(
        self, method: Method, clip: Clip, spp: float | None = None
    ) -> Iterator[FrameResult]:
        """Run a clip through a wrapper of the method, one frame per step."""
        return run_clip(method, clip, self.default_spp if spp is None else spp)

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


@dataclass(frozen=True)
class Check:
    """A requirement of every method, how it is tested, and how to meet it."""

    name: str
    requirement: str  # in the imperative, as printed
    remedy: str  # where a fault brings none of its own
    find_fault: Callable[[MethodUnderTest], Fault | str | None]
    requires: tuple[str, ...]  # skipped unless these checks pass
    skip_reason: Callable[[Traits], str | None]


def requirement(
    text: str,
    remedy: str,
    requires: tuple[str, ...] = ("built", "odd_size"),
    skip_reason: Callable[[Traits], str | None] = lambda traits: None,
) -> Callable[[Callable[[MethodUnderTest], Fault | str | None]], Check]:
    """Make a check of a function `check_NAME` that describes a method's fault, or returns None.

    `skip_reason` says why the check does not apply to a method of these traits, or None.
    """
    return lambda find_fault: Check(
        find_fault.__name__.removeprefix("check_"),
        text,
        remedy,
        find_fault,
        requires,
        skip_reason,
    )


@cache
def _make_clip(
    device: torch.device, seed: int, size: Size, pool_spp: int = POOL_SPP, static: bool = False
) -> InMemoryClip:
    """A closed-form clip in memory. All methods share it, so nothing may write to it.

    Its samples stand in for every kind of pool. It has every buffer of the clip format. The
    buffers behind glass and mirrors equal those of the first surface, because it has no glass.
    """
    clip = procedural_clip(seed, size, FRAMES, pool_spp, static=static, device=device)
    return to_clip([replace(frame, gbuffer=_add_buffers(frame.gbuffer)) for frame in clip])


def _add_buffers(gbuffer: GBuffer) -> GBuffer:
    """The G-buffer with every buffer of the format: `normal_NAME` is `normal`, and so on."""
    buffers = {**gbuffer.buffers, "object": gbuffer.buffers["depth"].isfinite().float()}
    for name in BUFFER_CHANNELS:
        first_surface = name.partition("_")[0]
        if first_surface in buffers:  # static clips have no motion
            buffers.setdefault(name, buffers[first_surface])
    return replace(gbuffer, buffers=buffers)


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
class RecordingMethod(MethodWrapper[Method]):
    """The wrapped method, and a record of its behaviour.

    It continues where a benchmark run stops with an error, so that one fault does not hide others:
    an undeclared buffer is provided, and an invalid density is replaced by a uniform one. The
    method receives copies, so that in-place writes have no further effect. What `denoise` returns
    must be an image and a state; anything else raises WrongReturnError.
    """

    buffers_read: set[str] = field(default_factory=set)
    modified: set[str] = field(default_factory=set)  # arguments that the method wrote to
    with_graph: set[str] = field(default_factory=set)  # return values that require gradients
    densities: list[Any] = field(default_factory=list)  # as planned
    counts: list[Tensor] = field(default_factory=list)  # sample counts after each pass

    @property
    def traits(self) -> Traits:
        """The wrapped method's traits, with every buffer as input, so that reads are recorded."""
        return replace(self.method.traits, inputs=frozenset(BUFFER_CHANNELS))

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """The wrapped method's density, or ones where it is invalid."""
        if len(self.densities) % len(self.method.traits.passes):
            self.counts.append(samples.counts)
        density = self._call(self.method.plan, gbuffer, samples, state)
        self.densities.append(density)
        self.with_graph.update({"density"} if has_graph(density) else ())
        return density if self._is_valid(density, samples) else torch.ones_like(samples.mean[:, :1])

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: State) -> tuple[Tensor, State]:
        """The wrapped method's image and next state."""
        self.counts.append(samples.counts)
        returned = self._call(self.method.denoise, gbuffer, samples, state)
        if fault := find_return_fault(returned, samples.counts.shape[0]):
            raise WrongReturnError(*fault)
        image, state = returned
        parts = (("image", image), ("state", state))
        self.with_graph.update(name for name, value in parts if has_graph(value))
        return image, state

    def _call(
        self, function: Callable[..., Any], gbuffer: GBuffer, samples: Samples, state: State
    ) -> Any:
        """Call `function` with copies and record which arguments it modified."""
        buffers = {name: buffer.clone() for name, buffer in gbuffer.buffers.items()}
        declared = {name: buffers[name] for name in buffers if name in self.method.traits.inputs}
        given = Samples(samples.radiance.clone(), samples.counts.clone())
        state_before = [tensor.clone() for tensor in iterate_tensors(state)]
        recorded = _RecordedBuffers(declared, self.buffers_read)
        result = function(_RecordingGBuffer(recorded, gbuffer.static, buffers), given, state)
        state_after = list(iterate_tensors(state))
        unchanged = {name: is_bit_equal(gbuffer.buffers[name], buffers[name]) for name in buffers}
        unchanged["samples"] = is_bit_equal(samples.radiance, given.radiance) and is_bit_equal(
            samples.counts, given.counts
        )
        unchanged["state"] = len(state_before) == len(state_after) and all(
            map(is_bit_equal, state_before, state_after)
        )
        self.modified.update(name for name in unchanged if not unchanged[name])
        return result

    def _is_valid(self, density: Any, samples: Samples) -> bool:
        """True if a benchmark run would accept this density."""
        if find_density_fault(density, samples.counts.shape):
            return False
        return self.method.traits.adaptive or bool(density.max() == density.min())


@dataclass(frozen=True)
class _RecordingGBuffer(GBuffer):
    """A G-buffer that also provides undeclared buffers; `buffers` records every read."""

    undeclared: Mapping[str, Tensor] = field(default_factory=dict)

    def _read(self, name: str) -> Tensor:
        is_undeclared = name not in self.buffers and name in self.undeclared
        if is_undeclared and isinstance(self.buffers, _RecordedBuffers):
            self.buffers.names_read.add(name)
            return self.undeclared[name]
        return super()._read(name)


@dataclass(frozen=True)
class _RecordedBuffers(Mapping[str, Tensor]):
    """Buffers by name, and the names that were read."""

    buffers: Mapping[str, Tensor]
    names_read: set[str]

    def __getitem__(self, key: str) -> Tensor:
        self.names_read.add(key)
        return self.buffers[key]

    def __contains__(self, key: object) -> bool:
        return key in self.buffers

    def __iter__(self) -> Iterator[str]:
        return iter(self.buffers)

    def __len__(self) -> int:
        return len(self.buffers)
