"""Denoise frames of which only a mean image is known: any row of the zoo as a tool.

    for image in rlbench.denoise(frames): ...

In the benchmark a method buys samples where it wants them, and sees each. A frame here was rendered
before, with the same number of samples everywhere, and its file holds their mean alone. The method
gets the mean in place of each sample, up to 8 of them, and is told how many samples are behind it.
So densities are not asked for, and the deviation of samples, which some rules read, is 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from rlbench import registry
from rlbench.clips.exposure import LIT, area_luminance, exposure_of_frames
from rlbench.errors import RlbenchError
from rlbench.frames import BUFFERS, Frame, GBuffer, Reference, Samples, Size, StoredPool
from rlbench.method import Method, State
from rlbench.ops.transfer import HALF_MAX
from rlbench.sanitize import FrameInput, Repairs, sanitize_frame

__all__ = [
    "DEFAULT_METHOD",
    "DenoiseError",
    "DenoisedFrame",
    "NoisyFrame",
    "check_denoises_means",
    "denoise",
    "denoise_frame",
    "estimate_exposure",
    "estimate_memory",
]

DEFAULT_METHOD = "accumulate/intel"
CLIPPED = f"radiance above {HALF_MAX:g} times display white"
TILE, OVERLAP = 2048, 128  # pixels: side of a tile, and what is seen around it; multiples of 32
BLEND = 128  # pixels in which one tile takes over from the other
FRAME_BYTES, METHOD_BYTES = 150, 1200  # of a pixel, about
MAX_SLOTS = 8  # of the largest pool that methods were trained with


class DenoiseError(RlbenchError, ValueError):
    """A method or a frame that cannot be denoised from a mean alone."""


@dataclass(frozen=True)
class NoisyFrame:
    """A rendered frame: the mean of its samples, and the G-buffer.

    The methods of the zoo read albedo, normal, depth and motion (`rlbench.GBuffer` has their units
    and signs); a method needs only those that its `traits.inputs` name. Of the first frame no
    motion is needed. `GBuffer(..., static=True)` says that nothing moves.
    """

    gbuffer: GBuffer
    mean: Float[Tensor, "n 3 h w"]  # linear radiance, at any exposure
    spp: float  # samples per pixel behind the mean, >= 1


@dataclass(frozen=True)
class DenoisedFrame:
    """An image, and what the next frame needs."""

    image: Float[Tensor, "n 3 h w"]  # linear radiance, at the exposure of the input
    state: State
    repairs: Repairs = field(default_factory=dict)  # invalid pixels that were replaced, by image


def denoise(
    frames: Iterable[NoisyFrame],
    method: str | Method = DEFAULT_METHOD,
    *,
    device: torch.device | str = "cpu",
    exposure: float | None = None,
) -> Iterator[Float[Tensor, "n 3 h w"]]:
    """Denoise the frames of one shot in order; yields the image of each, linear radiance.

    A frame is read when its image is asked for, so memory is that of one frame and of the method's
    state. Images are on the device of their frame. Radiance times `exposure` is 1 at display white;
    by default the first frame that has light decides, as in `rlbench render`, and the first that
    is so much brighter that its light would be clipped begins anew. After a cut, call it again.

    Raises DenoiseError for a method that needs more than the mean (see `check_denoises_means`), and
    for a frame without a buffer that the method reads.

    >>> frame = NoisyFrame(GBuffer({}, static=True), torch.rand(1, 3, 9, 11), spp=4)
    >>> [tuple(image.shape) for image in denoise([frame, frame], "mean")]
    [(1, 3, 9, 11), (1, 3, 9, 11)]
    """
    if isinstance(method, str):
        check_denoises_means(method)
        method = registry.load_method(method, device)
    state: State = None
    chosen = exposure
    for frame in frames:
        if exposure is None and (chosen is None or _peak(frame.mean) * chosen > HALF_MAX):
            own = estimate_exposure(frame.mean) if _peak(frame.mean) > 0 else None
            if own and (chosen is None or own < LIT * chosen):
                state, chosen = None, own
        result = denoise_frame(method, frame, state, chosen or 1.0, device)
        state = result.state
        yield result.image


@torch.inference_mode()
def denoise_frame(
    method: Method,
    frame: NoisyFrame,
    state: State,
    exposure: float,
    device: torch.device | str = "cpu",
) -> DenoisedFrame:
    """The image of one frame, and the method's state after it; `state` is None before the first.

    `exposure` must be the same in all frames of a shot. Raises DenoiseError as `denoise` does.
    """
    _check_frame(method, frame, is_first=state is None)
    n, _, h, w = frame.mean.shape
    state = method.start(Size(n, h, w)) if state is None else state
    valid, mean, clipped = _sanitize(method, frame, exposure, torch.device(device))
    slots = max(1, min(round(frame.spp), MAX_SLOTS))
    counts = torch.full_like(mean[:, :1], slots, dtype=torch.int64)
    radiance = mean.unsqueeze(1).expand(-1, slots, -1, -1, -1)  # takes no memory
    samples = Samples(radiance, counts, max(frame.spp / slots, 1.0))
    image, state = _denoise_tiles(method, valid.gbuffer, samples, state)
    valid.questions.answer()
    repairs = valid.repairs
    if count := int(clipped):
        repairs = {**repairs, CLIPPED: count, "radiance": repairs["radiance"] - count}
    repairs = {name: count for name, count in repairs.items() if count}
    return DenoisedFrame((image / exposure).to(frame.mean.device), state, repairs)


def _denoise_tiles(
    method: Method, gbuffer: GBuffer, samples: Samples, state: State
) -> tuple[Tensor, State]:
    """The image and the state; without a memory, a large frame takes the memory of one tile.

    Tiles are blended, because a method may expose each of them in its own way.
    """
    n, _, h, w = samples.counts.shape
    if method.traits.temporal or h * w <= TILE**2:
        return method.denoise(gbuffer, samples, state)
    image, total = torch.zeros_like(samples.radiance[:, 0]), samples.radiance.new_zeros(h, w)
    for y, x in product(range(0, h, TILE), range(0, w, TILE)):
        rows, columns = (
            slice(max(0, start - OVERLAP), min(end, start + TILE + OVERLAP))
            for start, end in ((y, h), (x, w))
        )
        crop = (..., rows, columns)
        buffers = {name: buffer[crop] for name, buffer in gbuffer.buffers.items()}
        drawn = replace(samples, radiance=samples.radiance[crop], counts=samples.counts[crop])
        size = Size(n, *drawn.counts.shape[-2:])
        tile, _ = method.denoise(GBuffer(buffers, gbuffer.static), drawn, method.start(size))
        weight = _ramp(rows, y, total)[:, None] * _ramp(columns, x, total)
        image[crop] += tile * weight
        total[crop] += weight
    return image / total, state


def _ramp(side: slice, start: int, like: Tensor) -> Float[Tensor, "*side"]:
    """Weights along one side of a tile that begins at `start`: 1 inside, 0 far outside."""
    place = torch.arange(side.start, side.stop, dtype=like.dtype, device=like.device) + 0.5
    return (0.5 + (TILE / 2 - (place - start - TILE / 2).abs()) / BLEND).clamp(0, 1)


def estimate_memory(method: Method, height: int, width: int) -> int:
    """The memory that a frame takes, about, in bytes: its images and the method's networks."""
    pixels = height * width
    inside = pixels if method.traits.temporal else min(pixels, (TILE + 2 * OVERLAP) ** 2)
    return FRAME_BYTES * pixels + METHOD_BYTES * inside


def check_denoises_means(name: str) -> None:
    """Raise DenoiseError if the method of this name cannot work from means; names some that can."""
    if reason := _refusal(name):
        candidates = [
            each for each in registry.expand([DEFAULT_METHOD, "all"]) if not _refusal(each)
        ]
        rows = [each for each in candidates if registry.get_variant(each).traits.temporal]
        raise DenoiseError(f"'{name}' {reason}. Rows that work: {', '.join(rows[:8])}, ...")


def estimate_exposure(means: Iterable[Float[Tensor, "3 h w"]]) -> float:
    """The exposure for mean images of a shot, as `rlbench import` chooses it; 1 for black ones."""
    valid = (mean.float().nan_to_num(0, 0, 0).clamp_min(0).movedim(0, -1) for mean in means)
    return exposure_of_frames(np.stack([area_luminance(image.cpu().numpy()) for image in valid]))


def _peak(mean: Tensor) -> float:
    """The largest finite value."""
    return float(mean.nan_to_num(0, 0, 0).amax())


def _refusal(name: str) -> str | None:
    """Why a method cannot work from means, None if it can."""
    traits = registry.get_variant(name).traits
    if traits.pool != "path":
        return f"needs samples of the pool '{traits.pool}', which a renderer does not write"
    if traits.reads_each_sample:
        return "reads samples one by one, and a frame has their mean alone"
    if others := sorted(traits.inputs - set(BUFFERS)):
        return f"reads the buffer {', '.join(others)}, which files of other renderers do not have"
    return None


def _check_frame(method: Method, frame: NoisyFrame, *, is_first: bool) -> None:
    """Raise DenoiseError for a number of samples below 1, or a buffer that is missing."""
    if not frame.spp >= 1:
        raise DenoiseError(f"a frame has {frame.spp:g} samples per pixel; a mean has at least 1")
    needed = method.traits.inputs - ({"motion"} if is_first or frame.gbuffer.static else set())
    if missing := sorted(needed - set(frame.gbuffer.buffers)):
        hint = "; GBuffer(..., static=True) says that nothing moves" * ("motion" in missing)
        raise DenoiseError(
            f"the method reads {', '.join(missing)}, and the frame has "
            f"{', '.join(frame.gbuffer.buffers) or 'no buffer'}{hint}"
        )


def _sanitize(
    method: Method, frame: NoisyFrame, exposure: float, device: torch.device
) -> tuple[FrameInput, Float[Tensor, "n 3 h w"], Tensor]:
    """The frame and its exposed mean on the device, invalid values replaced as in a run.

    Also the number of pixels whose light was clipped.
    """
    given, inputs = frame.gbuffer, method.traits.inputs
    buffers = {k: v.to(device) for k, v in given.select(inputs).buffers.items()}
    mean = frame.mean.to(device, torch.float32) * exposure
    pool = StoredPool(mean.unsqueeze(1), (0,) * len(mean))
    is_static = given.static or "motion" not in buffers
    frame_input = Frame(0, GBuffer(buffers, is_static), pool, Reference(mean, mean))
    valid = sanitize_frame(frame_input, inputs)
    one = torch.ones_like(mean[:, :1], dtype=torch.int64)
    clipped = (mean.isfinite().all(1) & (mean.amax(1) > HALF_MAX)).sum()
    return valid, valid.pool.read(valid.pool.empty(), one)[:, 0], clipped
