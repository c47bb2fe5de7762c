"""One frame through one method: the loop that training and benchmark share.

    state = method.start(clip.size)
    for each frame:
        for each pass: plan a density, turn it into whole sample counts, read these samples
        denoise the samples to an image and the next state
        answer what only the values can tell: errors, and counts of repairs

The method never receives the reference, a later frame, or a sample that its budget did not pay for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.family import Traits
from rlbench.frames import Clip, Frame, Samples
from rlbench.method import Method, State, checked_density
from rlbench.sampling import draw_pilot, draw_samples
from rlbench.sanitize import FrameInput, Repairs, sanitize_frame

__all__ = ["FrameResult", "run_clip", "run_frame", "unroll"]

ReadFrame = Callable[[Frame, frozenset[str]], FrameInput]


@dataclass(frozen=True)
class FrameResult:
    """A processed frame: the input, all samples drawn for it, and the method's image."""

    frame: Frame
    samples: Samples  # pilot and all passes, also those that the method discards
    image: Float[Tensor, "n 3 h w"]  # linear radiance
    repairs: Repairs  # invalid pixels and samples of the frame that were replaced, by buffer
    state: State = None  # what the method remembers after the frame


def unroll(
    method: Method, clip: Clip, spp: float, read: ReadFrame = sanitize_frame
) -> Iterator[FrameResult]:
    """Run `method` over `clip` in order, with gradients; yield one result per frame.

    `spp` is the budget in samples per pixel, as a mean over the image: each frame costs exactly
    round(spp * h * w) samples, the pilot and all passes included. `read` replaces invalid values of
    a frame; stress tests hand over `read_unsanitized`.

    Raises PluginError if a method varies its density without Traits(adaptive=True), and BudgetError
    (rlbench.sampling) if a density is invalid or the budget cannot pay for `Traits.min_samples`.
    """
    state = method.start(clip.size)
    for frame in clip:
        valid = read(frame, method.traits.inputs)
        samples, image, state = run_frame(method, valid, state, spp)
        valid.questions.answer()
        yield FrameResult(frame, samples, image, valid.repairs, state)


def run_frame(
    method: Method, frame: FrameInput, state: State, spp: float
) -> tuple[Samples, Float[Tensor, "n 3 h w"], State]:
    """The samples drawn for one frame, its image, and the next state.

    Nothing is asked of a GPU here, unless the method asks, so that the operations of a frame can be
    recorded and run again. Errors that values cause are raised when the frame's questions are
    answered; on a CPU, where they occur.
    """
    (gbuffer, pool, _, questions), traits = frame, method.traits
    drawn_spp = min(traits.pilot_spp, spp)
    samples = draw_pilot(pool, drawn_spp, questions)
    for share in traits.passes:
        previous = samples
        density = checked_density(method, gbuffer, previous, state, questions)
        total_spp = max(spp * share, drawn_spp)
        limits = _count_limits(traits, share, total_spp, drawn_spp)
        samples = draw_samples(
            pool, previous, density, total_spp, *limits, traits.discard_pilot, questions
        )
        drawn_spp = total_spp
    visible = samples.since(previous) if traits.discard_pilot else samples
    image, state = method.denoise(gbuffer, visible, state)
    return samples, image, state


@torch.inference_mode()  # as a decorator it is active while a frame is computed, not between frames
def run_clip(
    method: Method, clip: Clip, spp: float, read: ReadFrame = sanitize_frame
) -> Iterator[FrameResult]:
    """Run `method` over `clip` as `unroll` does, without gradients: for measurements.

    >>> from rlbench import registry
    >>> from rlbench.clips.in_memory import InMemoryClip
    >>> from rlbench.frames import GBuffer, Reference, StoredPool
    >>> pool = StoredPool(torch.rand(1, 8, 3, 9, 11), rounding_seeds=(0,))
    >>> grey = torch.full((1, 3, 9, 11), 0.5)
    >>> frame = Frame(0, GBuffer({}, static=True), pool, Reference(grey, grey))
    >>> clip = InMemoryClip("noise", "noise", "no digest", [frame])
    >>> method = registry.load_method("mean", torch.device("cpu"))
    >>> for result in run_clip(method, clip, spp=1.5):
    ...     print(tuple(result.image.shape), int(result.samples.counts.sum()))  # 1.5 * 9 * 11
    (1, 3, 9, 11) 148
    """
    yield from unroll(method, clip, spp, read)


def _count_limits(
    traits: Traits, share: float, total_spp: float, drawn_spp: float
) -> tuple[int, int | None]:
    """Least and most samples of one pixel after the pass that ends at `share` of the budget.

    An early pass that cannot pay for `min_samples` everywhere gives no pixel more than that, so
    that the later passes can still pay for the rest.
    """
    counted_spp = total_spp - drawn_spp if traits.discard_pilot else total_spp
    below_floor = share < 1 and counted_spp < traits.min_samples
    return (0, traits.min_samples) if below_floor else (traits.min_samples, traits.max_samples)
