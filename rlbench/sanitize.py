"""Sanitising in the core: a method reads valid frames alone, and what was repaired is counted.

The rules are those of rlbench.ops.sanitize, the same for every method. A method may rely on the
ranges that they guarantee; it must still keep its own state finite.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from jaxtyping import Bool, Float, Int
from torch import Tensor

from rlbench.frames import Frame, GBuffer, Pool, PoolWrapper, Samples
from rlbench.ops.sanitize import RULES, sanitize_radiance
from rlbench.questions import Questions

__all__ = ["FrameInput", "Repairs", "SanitizedPool", "read_unsanitized", "sanitize_frame"]

Repairs = Mapping[str, int]  # repaired pixels by buffer, and repaired samples as "radiance"


class FrameInput(NamedTuple):
    """What a method may use of a frame: the buffers that it declares, and samples to draw."""

    gbuffer: GBuffer
    pool: Pool
    repairs: Repairs  # all of them once `questions` are answered
    questions: Questions


def sanitize_frame(frame: Frame, inputs: frozenset[str]) -> FrameInput:
    """Valid buffers, those named in `inputs` alone, and a pool of valid samples.

    Repairs count pixels; repaired samples are added to them when they are drawn. Buffers without a
    rule, such as object numbers, stay as they are.

    >>> import torch
    >>> from rlbench.frames import Reference, StoredPool
    >>> depth = torch.tensor([[[[1.0, -1.0, torch.nan]]]])
    >>> half = torch.zeros(1, 3, 1, 3)
    >>> pool = StoredPool(torch.ones(1, 2, 3, 1, 3), rounding_seeds=(0,))
    >>> frame = Frame(0, GBuffer({"depth": depth}), pool, Reference(half, half))
    >>> valid = sanitize_frame(frame, frozenset({"depth"}))
    >>> valid.gbuffer.depth.tolist(), valid.repairs["depth"]
    ([[[[1.0, 1.0, inf]]]], 2)
    """
    if frame.is_sanitized:
        return read_unsanitized(frame, inputs)
    pool, buffers = SanitizedPool(frame.pool), {}
    for name, buffer in frame.gbuffer.select(inputs).buffers.items():
        rule = RULES.get(name.partition("_")[0])
        buffers[name] = valid = rule(buffer) if rule else buffer
        if valid is not buffer:
            pool.count(name, (valid != buffer).any(1))
    gbuffer = GBuffer(buffers, frame.gbuffer.static)
    return FrameInput(gbuffer, pool, pool.repairs, pool.questions)


def read_unsanitized(frame: Frame, inputs: frozenset[str]) -> FrameInput:
    """The frame as the renderer wrote it, for tests of a method's own robustness."""
    return FrameInput(frame.gbuffer.select(inputs), frame.pool, {}, Questions())


@dataclass(frozen=True)
class SanitizedPool(PoolWrapper):
    """A pool whose samples are valid radiance; how many were repaired is one of `questions`."""

    repairs: Counter[str] = field(default_factory=Counter)
    questions: Questions = field(default_factory=Questions)

    def read(self, before: Samples, counts: Int[Tensor, "n 1 h w"]) -> Float[Tensor, "n s 3 h w"]:
        """Radiance of the first `counts` samples of each pixel, sanitised."""
        radiance = super().read(before, counts)
        valid = sanitize_radiance(radiance)
        if valid is not radiance:
            is_new = ~Samples(radiance, before.counts).valid_mask  # the others are counted already
            self.count("radiance", (valid != radiance).any(2, keepdim=True) & is_new)
        return valid

    def count(self, name: str, is_repaired: Bool[Tensor, "*size"]) -> None:
        """Add the repaired pixels or samples to `repairs`, now or when questions are answered."""

        def add(answer: list[float]) -> None:
            if repaired := int(answer[0]):
                self.repairs[name] += repaired

        self.questions.ask(is_repaired.sum()[None], add)
