"""Checks of memory: runs repeat, all memory is in the state, and no pixel sees too far.

A check returns a description of the fault, or None if the method conforms. They are printed in the
order in which they are defined.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from itertools import chain, zip_longest
from typing import NamedTuple

import torch
from torch import Tensor

from rlbench.checks.conformance.interface_checks import find_nonfinite
from rlbench.checks.conformance.method_under_test import (
    ODD_SIZE,
    OTHER_SEED,
    SEED,
    MethodUnderTest,
    RecordedRun,
    RecordingMethod,
    requirement,
)
from rlbench.checks.frame_edits import select_clip, start_new_shot, stored_radiance, to_clip
from rlbench.family import Traits
from rlbench.frames import Frame, GBuffer, Reference, Samples, Size, StoredPool
from rlbench.method import Method, State
from rlbench.ops.nested_tensors import is_bit_equal, iterate_tensors
from rlbench.ops.tiles import Window
from rlbench.returns import describe_value
from rlbench.run import FrameResult
from rlbench.wrappers import MethodWrapper, crop_inputs, map_state

TOLERANCE = 1e-3  # relative and absolute: convolutions add in another order for another batch
# size, and float32 values pass through some 20 of them
BRIGHTER = 1000.0  # factor on the radiance of the changed pixel: an average of the image would move
COMPARED = ("built", "odd_size", "determinism")  # required where two runs are compared
KEEP_STATE = "keep all memory in the returned state, none in the method or in modules"


@requirement(
    "return bit-identical images in a second run",
    f"draw from a seeded torch.Generator; {KEEP_STATE}",
)
def check_determinism(tested: MethodUnderTest) -> str | None:
    """Random numbers depend only on the method's arguments."""
    first, second = tested.default_run.images, tested.run(tested.clip()).images
    if all(map(is_bit_equal, first, second)):
        return None
    difference = _max_difference(first, second)
    return f"expected equal images in a second run, found differences of up to {difference:g}"


@requirement(
    "use neither the reference nor undrawn samples",
    "use only the arguments gbuffer, samples and state",
    COMPARED,
)
def check_leak(tested: MethodUnderTest) -> str | None:
    """With NaN as the reference and as all undrawn samples, the images stay the same."""
    first = tested.default_run
    second = tested.run(to_clip(map(_with_nan_reference, first.frames)))
    changed = sum(not same for same in map(is_bit_equal, first.images, second.images))
    if not changed:
        return None
    found = f"found {changed} of {len(first.frames)} changed when"
    return f"expected equal images, {found} the reference and all undrawn samples are NaN"


@requirement(
    "treat the clips of a batch independently",
    "reduce over dimensions c, h and w, never over n",
    (*COMPARED, "density"),
)
def check_batch(tested: MethodUnderTest) -> str | None:
    """Each clip alone equals its part of a batch of two."""
    clip = tested.clip(n=2)
    batch, frames = tested.run(clip), list(clip)
    faults = (_compare_to_single(tested, batch, frames, i) for i in range(2))
    return next(filter(None, faults), None)


@requirement("treat clips that run in turns independently", KEEP_STATE, COMPARED)
def check_interleaved(tested: MethodUnderTest) -> str | None:
    """Frames of another clip in between change nothing."""
    pair = [tested.small_clip(seed) for seed in (SEED, OTHER_SEED)]
    alone = [tested.run(clip).images for clip in pair]
    turns = zip_longest(*(tested.run_with(RecordingMethod(tested.method), clip) for clip in pair))
    images = [frame.image for frame in chain.from_iterable(turns)]
    changed = sum(not is_bit_equal(image, alone[i % 2][i // 2]) for i, image in enumerate(images))
    if not changed:
        return None
    found = f"found {changed} of {len(images)} changed by frames of the other clip"
    return f"expected the images of each clip alone, {found}"


@requirement(
    "run without motion on static clips",
    "pass gbuffer.motion, which is None there, to rlbench.ops.reproject unchanged",
    ("built", "odd_size", "image"),
)
def check_static(tested: MethodUnderTest) -> str | None:
    """A static clip has no motion buffer, and `gbuffer.motion` is None."""
    return find_nonfinite(tested.run(tested.small_clip(static=True)).frames)


@requirement(
    "discard history at cuts",
    "reproject the state with rlbench.ops.reproject_or_fill, which replaces what lay outside",
    COMPARED,
)
def check_cut(tested: MethodUnderTest) -> str | None:
    """Where all motion points outside the image, the result equals that of a first frame."""
    *before, last = tested.small_clip()
    first = start_new_shot(last)
    after_cut = tested.run(to_clip([*before, first])).images[-1:]
    alone = tested.run(to_clip([first])).images
    if is_bit_equal(after_cut[0], alone[0]):
        return None
    found = f"found differences of up to {_max_difference(after_cut, alone):g} after another shot"
    return f"expected the image of a first frame, {found}"


@requirement(
    "depend on one frame alone unless declared temporal",
    "declare Traits(temporal=True)",
    COMPARED,
    lambda traits: "Traits(temporal=True)" if traits.temporal else None,
)
def check_temporal(tested: MethodUnderTest) -> str | None:
    """Without a state, a frame does not depend on earlier frames."""
    run = tested.default_run
    states = [frame.state for frame in run.frames]
    if any(state is not None and state is not states[0] for state in states):
        found = f"found another state, {describe_value(states[-1])}, after each frame"
        return f"expected None or the state that was given, {found}"
    alone = tested.run(to_clip([run.frames[-1].frame])).images
    if is_bit_equal(alone[0], run.images[-1]):
        return None
    found = f"found differences of up to {_max_difference(alone, run.images[-1:]):g}"
    return f"expected the same image without earlier frames, {found}"


@requirement(
    "return the same results from a copy of the state",
    f"{KEEP_STATE}; build the state from tensors and plain values",
    COMPARED,
)
def check_state_copy(tested: MethodUnderTest) -> str | None:
    """Stress tests swap, corrupt and reset the state; the latency measurement reuses it."""
    method = _ReplayFromCopy(RecordingMethod(tested.method))
    list(tested.run_with(method, tested.small_clip()))
    if not method.changed:
        return None
    found = " and ".join(sorted(method.changed))
    return f"expected equal results from a copied state, found another {found}"


def _skip_without_field(traits: Traits) -> str | None:
    if traits.receptive_field is None:
        return "Traits(receptive_field=None)"
    if traits.receptive_field + 1 >= ODD_SIZE.w:
        return f"its frames of {ODD_SIZE.w} pixels hold no pixel out of reach"
    return None


@requirement(
    "depend on no pixel beyond the receptive field, where one is declared",
    "set Traits(receptive_field=...) to the sum of all filter radii, or to None; return None "
    "or a named tuple of tensors [n c h w] as the state",
    COMPARED,
    _skip_without_field,
)
def check_receptive_field(tested: MethodUnderTest) -> str | None:
    """One pixel changes in all inputs; pixels out of reach stay, and so they do in a window."""
    keeper = _KeepInputs(tested.method)
    list(tested.run_with(keeper, tested.clip()))
    inputs, radius, size = keeper.calls[-1], tested.traits.receptive_field or 0, tested.size
    with torch.inference_mode():
        before = _outputs(keeper.method, inputs)
        after = _outputs(keeper.method, _change_pixel(inputs, size.h // 2, 0))
        near = Window(slice(size.h // 2, size.h // 2 + 1), slice(0, 1)).grow(radius, size.h, size.w)
        far = torch.ones(size.h, size.w, dtype=torch.bool, device=tested.device)
        far[near.rows, near.columns] = False
        changed = torch.stack(
            [(a != b).flatten(0, -3).any(0) for a, b in zip(before, after, strict=True)]
        )
        if reached := int((changed.any(0) & far).sum()):
            return (
                f"expected one pixel to change none farther away than {radius} pixels, found "
                f"{reached} of {int(far.sum())} changed"
            )
        return _compare_to_window(keeper.method, inputs, before, radius, size)


@dataclass(frozen=True)
class _ReplayCounts(MethodWrapper[RecordingMethod]):
    """The wrapped method, given recorded sample counts instead of those that it plans."""

    counts: Sequence[Tensor]  # after each pass

    @property
    def traits(self) -> Traits:
        """The wrapped method's traits, made adaptive, because the counts vary between pixels."""
        return replace(self.method.traits, adaptive=True)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """The recorded counts as a density; the wrapped method's own density is recorded."""
        super().plan(gbuffer, samples, state)
        return self.counts[len(self.method.densities) - 1].double()


@dataclass(frozen=True)
class _ReplayFromCopy(MethodWrapper[Method]):
    """The wrapped method, called twice per step, the second time with a copy of the state."""

    changed: set[str] = field(default_factory=set)  # results that differed the second time

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Tensor:
        """The density computed from the copied state."""
        copied = deepcopy(state)
        first = super().plan(gbuffer, samples, state)
        second = super().plan(gbuffer, samples, copied)
        self.changed.update(() if is_bit_equal(first, second) else {"density"})
        return second

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: State) -> tuple[Tensor, State]:
        """The image and the next state computed from the copied state."""
        copied = deepcopy(state)
        first, _ = super().denoise(gbuffer, samples, state)
        second, next_state = super().denoise(gbuffer, samples, copied)
        self.changed.update(() if is_bit_equal(first, second) else {"image"})
        return second, next_state


class _Inputs(NamedTuple):
    """The arguments of one call of `denoise`."""

    gbuffer: GBuffer
    samples: Samples
    state: State


@dataclass(frozen=True)
class _KeepInputs(MethodWrapper[Method]):
    """A method, and the arguments of its calls of `denoise`."""

    calls: list[_Inputs] = field(default_factory=list)

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: State) -> tuple[Tensor, State]:
        """The wrapped method's image and next state."""
        self.calls.append(_Inputs(gbuffer, samples, state))
        return super().denoise(gbuffer, samples, state)


def _with_nan_reference(result: FrameResult) -> Frame:
    """The result's frame with NaN as its reference and in every sample that was not drawn."""
    frame, nan = result.frame, float("nan")
    radiance = stored_radiance(frame).where(result.samples.valid_mask, nan)
    half = torch.full_like(frame.reference.half_a, nan)
    pool = StoredPool(radiance, frame.pool.rounding_seeds)
    return replace(frame, pool=pool, reference=Reference(half, half))


def _compare_to_single(
    tested: MethodUnderTest, batch: RecordedRun, frames: list[Frame], i: int
) -> str | None:
    """How clip `i` of a batch differs from the same clip alone, or None.

    The clip alone gets the sample counts of the batch, because the last bit of a density can change
    them.
    """
    recording = RecordingMethod(tested.method)
    method = _ReplayCounts(recording, [counts[i : i + 1] for counts in batch.recording.counts])
    single = to_clip([select_clip(frame, i) for frame in frames])
    images = [frame.image for frame in tested.run_with(method, single)]
    for name, batched, alone in (
        ("images", batch.images, images),
        ("densities", batch.recording.densities, recording.densities),
    ):
        item = [tensor[i : i + 1] for tensor in batched]
        if not all(map(_is_close, item, alone)):
            found = f"found differences of up to {_max_difference(item, alone):g} in clip {i} of 2"
            return f"expected {name} within {TOLERANCE:g} of those of each clip alone, {found}"
    return None


def _compare_to_window(
    method: Method, inputs: _Inputs, images: list[Tensor], radius: int, size: Size
) -> str | None:
    """How a window on the right differs from the image, or None."""
    core = Window(slice(0, size.h), slice(min(size.w - 1, radius + 3), size.w))
    read = core.grow(radius, size.h, size.w)
    inner = core.relative_to(read)
    parts = _outputs(method, _Inputs(*crop_inputs(*inputs, read)))
    for image, part in zip(images, parts, strict=True):
        expected, found = core.crop(image), inner.crop(part)
        if not _is_close(found, expected):
            return (
                f"expected the image's pixels within {TOLERANCE:g} in a window that holds {radius} "
                f"pixels around them, found differences of up to "
                f"{_max_difference([found], [expected]):g}"
            )
    return None


def _outputs(method: Method, inputs: _Inputs) -> list[Tensor]:
    """The image, and the tensors of the next state."""
    image, state = method.denoise(*inputs)
    return [image, *iterate_tensors(state)]


def _change_pixel(inputs: _Inputs, y: int, x: int) -> _Inputs:
    """The inputs with other values of one pixel: a bright sample, and other buffers and state."""

    def change(tensor: Tensor) -> Tensor:
        changed = tensor.clone()
        changed[..., y, x] = 0.5 * changed[..., y, x] + 0.25
        return changed

    gbuffer, samples, state = inputs
    counts, radiance = samples.counts.clone(), samples.radiance.clone()
    counts[..., y, x] = 1
    radiance[..., y, x] = 0.0
    radiance[:, 0, :, y, x] = BRIGHTER
    buffers = {name: change(buffer) for name, buffer in gbuffer.buffers.items()}
    samples = Samples(radiance, counts)
    return _Inputs(GBuffer(buffers, gbuffer.static), samples, map_state(change, state))


def _is_close(one: Tensor, other: Tensor) -> bool:
    if one.shape != other.shape:
        return False
    return torch.allclose(
        one.double(), other.double(), rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True
    )


def _max_difference(some: list[Tensor], others: list[Tensor]) -> float:
    """The largest absolute difference; NaN where shapes differ."""
    pairs = list(zip(some, others, strict=True))
    if any(one.shape != other.shape for one, other in pairs):
        return float("nan")
    return max(float((one - other).abs().max()) for one, other in pairs)
