"""Section precision: float64 as truth for lower precisions; reruns, threads, batch, device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor, nn

from rlbench.checks.display import largest_difference, psnr
from rlbench.checks.frame_edits import edit_tensors, select_clip, to_clip
from rlbench.checks.result import CheckResult, Limits, judge, not_applicable
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.checks.stress.wrappers import RecordDensity, ReplayDensity
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.method import Method
from rlbench.wrappers import HalfPrecision

SEED = 7200
CLIPS = 3  # in the batch; all other tests run the first one alone
SIZE, QUICK_SIZE = Size(CLIPS, 32, 48), Size(CLIPS, 16, 24)
FRAMES, QUICK_FRAMES = 5, 3
THREAD_FRAMES = 2  # one without history, one with: two threads on a busy core are slow

# PSNR is reported with two digits, so float32 must not change them.
FLOAT32_LOSS = Limits(good=0.005, fair=0.1, unit="dB")
# An ablation's differences are a few tenths of a dB.
HALF_LOSS = Limits(good=0.1, fair=0.5, unit="dB")
# 1e-3 is the blast radius' threshold of a changed pixel; 1/255 is a step of an 8-bit display.
FLOAT32_PIXEL = Limits(good=1e-3, fair=1 / 255, unit="display")
# bf16 has 8 bits, so a step of 8-bit sRGB is unavoidable; 8 steps are visible in a smooth region.
HALF_PIXEL = Limits(good=8 / 255, fair=32 / 255, unit="display")
BIT_EQUAL = Limits(good=0.0, fair=0.0, unit="display")

KEEP_FLOAT32 = "compute exposure, sums over many pixels, divisions and logarithms in float32"


@dataclass(frozen=True)
class _HeldRuns:
    """Runs of one method over one clip; all but the first replay its densities."""

    stressed: StressedMethod
    clip: InMemoryClip

    @property
    def described(self) -> str:
        """The clip's length and size."""
        return f"{len(self.clip)} frames of {self.clip.size.w}x{self.clip.size.h}"

    @cached_property
    def recording(self) -> tuple[list[Tensor], list[Tensor]]:
        """The images in float32, and the densities."""
        method = RecordDensity(self.stressed.method)
        return self.images(method, self.clip), method.densities

    def images(self, method: Method, clip: InMemoryClip) -> list[Tensor]:
        """The images of a clip."""
        return [result.image for result in self.stressed.run(clip, method=method)]

    def replay(self, method: Method, clip: InMemoryClip | None = None) -> list[Tensor]:
        """The images of the clip, or of the same clip converted, with the recorded densities."""
        held = ReplayDensity.of(method, self.recording[1])
        return self.images(held, self.clip if clip is None else clip)

    @cached_property
    def truth(self) -> list[Tensor] | Exception:
        """The images in float64, or the exception that a method raises there."""
        try:
            method = convert_method(self.stressed.method, torch.float64)
            densities = self.recording[1]  # in the usual default dtype
            with _default_dtype(torch.float64):
                clip = _convert_clip(self.clip, torch.float64)
                images = self.images(ReplayDensity.of(method, densities), clip)
        except Exception as error:  # a method may raise anything in a precision it was not made for
            return error
        if images[-1].dtype != torch.float64:
            return TypeError(f"the image is {images[-1].dtype}, so a part computes in it")
        return images

    def loss(self, truth: list[Tensor], images: list[Tensor]) -> float:
        """dB by which the mean PSNR of `images` is below that of `truth`."""
        references = [frame.reference.mean for frame in self.clip]
        pairs = zip(truth, images, references, strict=True)
        losses = [psnr(best.to(ref), ref) - psnr(image.to(ref), ref) for best, image, ref in pairs]
        return float(torch.stack(losses).mean())


def run(stressed: StressedMethod, is_quick: bool) -> Iterator[CheckResult]:
    """All tests of one method."""
    size, frames = (QUICK_SIZE, QUICK_FRAMES) if is_quick else (SIZE, FRAMES)
    batch = to_clip(procedural_clip(SEED, size, frames, device=stressed.device))
    runs = _HeldRuns(stressed, to_clip(select_clip(frame, 0) for frame in batch))
    if isinstance(runs.truth, Exception):
        yield from _skip_precision("float32", f"float64: {_first_line(runs.truth)}")
    else:
        images, _ = runs.recording
        yield from _judge_pair(runs, "float32", images, FLOAT32_LOSS, FLOAT32_PIXEL)
    yield from _judge_reduced(runs, "bf16", torch.bfloat16)
    if not is_quick:  # slow on a CPU, and on busy cores
        yield from _judge_reduced(runs, "fp16", torch.float16)
        yield _judge_threads(runs)
    yield _judge_rerun(runs)
    yield _judge_batch(_HeldRuns(stressed, batch))
    yield _judge_device(runs)


def _judge_reduced(runs: _HeldRuns, label: str, dtype: torch.dtype) -> Iterator[CheckResult]:
    """A reduced precision against float64, or against float32 where there is no float64."""
    try:
        images = runs.replay(HalfPrecision(runs.stressed.method, runs.stressed.device, dtype))
    except Exception as error:  # a method may raise anything in a precision it was not made for
        yield from _skip_precision(label, f"{label}: {_first_line(error)}")
        return
    yield from _judge_pair(runs, label, images, HALF_LOSS, HALF_PIXEL)


def _skip_precision(label: str, reason: str) -> Iterator[CheckResult]:
    for test in (label, f"{label}-worst-pixel"):
        yield not_applicable(test, f"does not run in {reason}")


def _judge_pair(
    runs: _HeldRuns, label: str, images: list[Tensor], loss: Limits, pixel: Limits
) -> Iterator[CheckResult]:
    """dB lost and worst pixel of images of a lower precision."""
    has_truth = not isinstance(runs.truth, Exception)
    truth = runs.recording[0] if isinstance(runs.truth, Exception) else runs.truth
    against = f"against {'float64' if has_truth else 'float32'}, {runs.described}"
    yield judge(label, runs.loss(truth, images), loss, against, KEEP_FLOAT32)
    worst = largest_difference(truth, images)
    yield judge(f"{label}-worst-pixel", worst, pixel, against, KEEP_FLOAT32)


def _judge_rerun(runs: _HeldRuns) -> CheckResult:
    """A second run with free densities must be equal in every bit."""
    again = RecordDensity(runs.stressed.method)
    images = runs.images(again, runs.clip)
    pairs = zip((*images, *again.densities), (*runs.recording[0], *runs.recording[1]), strict=True)
    changed = sum(not torch.equal(one, other) for one, other in pairs)
    worst = largest_difference(images, runs.recording[0]) if changed else 0.0
    found = f"{changed} images and densities differ, {runs.described}"
    remedy = "seed every random number from arguments, and keep no state in the method"
    limits = BIT_EQUAL if worst or not changed else Limits(0.0, -1.0)  # densities alone differ
    return judge("rerun", worst, limits, found, remedy)


def _judge_threads(runs: _HeldRuns) -> CheckResult:
    """Two threads against one, with the densities held."""
    clip = to_clip(runs.clip.frames[:THREAD_FRAMES])
    images = []
    for threads in (1, 2):
        with _thread_count(threads):
            images.append(runs.replay(runs.stressed.method, clip))
    remedy = "add in an order that does not depend on threads: no atomics, no data races"
    return _judge_difference("threads", largest_difference(*images), remedy)


def _judge_batch(runs: _HeldRuns) -> CheckResult:
    """Each clip alone against its part of the batch, with the densities of the batch."""
    images, densities = runs.recording
    worst = 0.0
    for i in range(CLIPS):
        single = to_clip(select_clip(frame, i) for frame in runs.clip)
        held = [density[i : i + 1] for density in densities]
        alone = runs.images(ReplayDensity.of(runs.stressed.method, held), single)
        worst = max(worst, largest_difference(alone, [image[i : i + 1] for image in images]))
    remedy = "reduce over the dimensions of one image, never over the batch"
    return _judge_difference("batch", worst, remedy)


def _judge_device(runs: _HeldRuns) -> CheckResult:
    """The other kind of device, if there is one."""
    if not torch.cuda.is_available():
        return not_applicable("device", "this machine has no CUDA device")
    stressed = runs.stressed
    other = torch.device("cuda" if stressed.device.type == "cpu" else "cpu")
    method = convert_method(stressed.method, device=other)
    images = runs.replay(method, _convert_clip(runs.clip, device=other))
    images = [image.to(stressed.device) for image in images]
    worst = largest_difference(images, runs.recording[0])
    remedy = "avoid TF32 and operations whose result depends on the device"
    return _judge_difference("device", worst, remedy)


def _judge_difference(test: str, worst: float, remedy: str) -> CheckResult:
    """The worst pixel where sums may be added in another order."""
    found = f"largest difference {worst:.2g} on the display, sample counts held"
    return judge(test, worst, FLOAT32_PIXEL, found, remedy)


def _first_line(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"


def convert_method(
    method: Method, dtype: torch.dtype | None = None, device: torch.device | None = None
) -> Method:
    """A copy of a method with all networks and float tensors in `dtype` and on `device`.

    They are found in the fields of the method and of its parts, at any depth. A device or a dtype
    in a field is replaced too.
    """
    copy = deepcopy(method)
    _convert_parts(copy, dtype, device, set())
    return copy


def _convert_clip(
    clip: InMemoryClip, dtype: torch.dtype | None = None, device: torch.device | None = None
) -> InMemoryClip:
    """The clip with all tensors in `dtype` and on `device`."""
    return to_clip(
        edit_tensors(frame, lambda tensor: tensor.to(dtype=dtype, device=device)) for frame in clip
    )


def _convert_parts(
    part: Any, dtype: torch.dtype | None, device: torch.device | None, visited: set[int]
) -> None:
    """Convert the fields of an object, of its parts, and the items of its containers."""
    if id(part) in visited or isinstance(part, str | bytes | type | Tensor):
        return
    visited.add(id(part))
    if isinstance(part, nn.Module):
        part.to(dtype=dtype, device=device)
    slots: Any = part if isinstance(part, dict | list) else getattr(part, "__dict__", {})
    for key, value in list(enumerate(slots) if isinstance(slots, list) else slots.items()):
        slots[key] = _converted(value, dtype, device)
    children = slots.values() if isinstance(slots, dict) else slots
    for child in part if isinstance(part, tuple) else children:
        _convert_parts(child, dtype, device, visited)


def _converted(value: Any, dtype: torch.dtype | None, device: torch.device | None) -> Any:
    """A float tensor in `dtype`, any tensor on `device`; a device replaced; else the value."""
    if isinstance(value, Tensor) and not isinstance(value, nn.Parameter):
        return value.to(device=device, dtype=dtype if value.is_floating_point() else None)
    if isinstance(value, torch.device) and device is not None:
        return device
    return value


@contextmanager
def _default_dtype(dtype: torch.dtype) -> Iterator[None]:
    """New tensors have `dtype` unless they are created with another one."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


@contextmanager
def _thread_count(threads: int) -> Iterator[None]:
    """Torch computes on the CPU with this number of threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)


SECTION = MethodSection(run)
