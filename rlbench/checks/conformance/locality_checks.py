"""Checks of a declared receptive field: how far `denoise` looks, in the image and in its windows.

A check returns a description of the fault, or None if the method conforms.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from rlbench.checks.conformance import clips
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.conformance.state_checks import TOLERANCE
from rlbench.checks.tensors import iterate_tensors
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.method import Method, State
from rlbench.ops.tiles import Window
from rlbench.run import run_clip
from rlbench.wrappers import MethodWrapper, crop_inputs, map_state

BRIGHTER = 1000.0  # factor on the radiance of the changed pixel: an average of the image would move


class Inputs(NamedTuple):
    """The arguments of one call of `denoise`."""

    gbuffer: GBuffer
    samples: Samples
    state: State


@dataclass(frozen=True)
class _KeepInputs(MethodWrapper[Method]):
    """A method, and the arguments of its calls of `denoise`."""

    calls: list[Inputs] = field(default_factory=list)

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: State) -> tuple[Tensor, State]:
        """The wrapped method's image and next state."""
        self.calls.append(Inputs(gbuffer, samples, state))
        return super().denoise(gbuffer, samples, state)


def check_receptive_field(method_under_test: MethodUnderTest) -> str | None:
    """One pixel changes in all inputs; pixels out of reach stay, and so they do in a window."""
    keeper = _KeepInputs(method_under_test.method)
    list(run_clip(keeper, method_under_test.clip(), method_under_test.default_spp))
    inputs, radius = keeper.calls[-1], method_under_test.traits.receptive_field or 0
    size = method_under_test.size
    with torch.inference_mode():
        before = _outputs(keeper.method, inputs)
        after = _outputs(keeper.method, _change_pixel(inputs, size.h // 2, 0))
        near = Window(slice(size.h // 2, size.h // 2 + 1), slice(0, 1)).grow(radius, size.h, size.w)
        far = torch.ones(size.h, size.w, dtype=torch.bool, device=method_under_test.device)
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


def skip_without_field(traits: Traits) -> str | None:
    """Why `check_receptive_field` does not apply, or None."""
    if traits.receptive_field is None:
        return "Traits(receptive_field=None)"
    if traits.receptive_field + 1 >= clips.ODD_SIZE.w:
        return f"its frames of {clips.ODD_SIZE.w} pixels hold no pixel out of reach"
    return None


def _compare_to_window(
    method: Method, inputs: Inputs, images: list[Tensor], radius: int, size: Size
) -> str | None:
    """How a window on the right differs from the image, or None."""
    core = Window(slice(0, size.h), slice(min(size.w - 1, radius + 3), size.w))
    read = core.grow(radius, size.h, size.w)
    inner = core.relative_to(read)
    parts = _outputs(method, Inputs(*crop_inputs(*inputs, read)))
    for image, part in zip(images, parts, strict=True):
        expected, found = core.crop(image), inner.crop(part)
        if not torch.allclose(found, expected, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True):
            difference = float((found - expected).abs().max())
            return (
                f"expected the image's pixels within {TOLERANCE:g} in a window that holds "
                f"{radius} pixels around them, found differences of up to {difference:g}"
            )
    return None


def _outputs(method: Method, inputs: Inputs) -> list[Tensor]:
    """The image, and the tensors of the next state."""
    image, state = method.denoise(*inputs)
    return [image, *iterate_tensors(state)]


def _change_pixel(inputs: Inputs, y: int, x: int) -> Inputs:
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
    return Inputs(
        GBuffer(buffers, gbuffer.static),
        Samples(radiance, counts),
        map_state(change, state),
    )
