"""Tiny methods, each with one fault, and the check that must find it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import count
from types import SimpleNamespace
from typing import Any, NamedTuple

import torch
from torch.nn import functional as F

from rlbench.family import Family, Traits, Variant
from rlbench.frames import Size
from rlbench.ops.reprojection import reproject_or_fill

SIZE, SMALL_SIZE = Size(1, 19, 31), Size(1, 17, 23)  # faults show in small frames as well
CORRECT = Traits(inputs=frozenset({"albedo", "motion"}), adaptive=True, temporal=True)


@dataclass(frozen=True)
class Correct:
    """A correct method; each fault overrides a part of it. It adds half of its history."""

    traits: Traits = CORRECT
    hidden: dict[str, Any] = field(default_factory=dict)  # memory outside the state

    def start(self, size):
        return None

    def plan(self, gbuffer, samples, state):
        density = gbuffer.albedo.mean(1, keepdim=True) + 0.1
        if state is None:
            return density
        return density + reproject_or_fill(state, gbuffer.motion, 0.0).mean(1, True)

    def denoise(self, gbuffer, samples, state):
        history = 0.0 if state is None else reproject_or_fill(state, gbuffer.motion, 0.0)
        image = samples.mean + 0.5 * history
        return image, image


@dataclass(frozen=True)
class UncheckedTraits(Traits):
    """Traits without validation."""

    def __post_init__(self):
        pass


LOCAL = Traits(inputs=frozenset({"albedo"}), receptive_field=0)


class Handle:
    """A state that is only a key to memory kept elsewhere."""


@dataclass(frozen=True)
class Stateless(Correct):
    """A correct method without state, with a constant density."""

    def plan(self, gbuffer, samples, state):
        return torch.ones_like(gbuffer.albedo[:, :1])

    def denoise(self, gbuffer, samples, state):
        return samples.mean + 0 * gbuffer.albedo, None


@dataclass(frozen=True)
class Changed(Correct):
    """Does something to its inputs, and changes the density and the image of the correct method.

    Its state is that of the correct method.
    """

    touch: Callable[..., Any] = lambda gbuffer, samples: None
    redirect: Callable[..., Any] = lambda density: density
    edit: Callable[..., Any] = lambda image, samples: image

    def plan(self, gbuffer, samples, state):
        return self.redirect(super().plan(gbuffer, samples, state))

    def denoise(self, gbuffer, samples, state):
        self.touch(gbuffer, samples)
        image, state = super().denoise(gbuffer, samples, state)
        return self.edit(image, samples), state


def changed(**changes):
    return lambda traits: Changed(traits, **changes)


def edited(edit):
    return changed(edit=edit)


def stateless(make):
    """Methods without state and history; `make` makes their image of that of the samples."""

    class Made(Stateless):
        def denoise(self, gbuffer, samples, state):
            return make(super().denoise(gbuffer, samples, state)[0]), None

    return Made


def read_frame():
    """Finds the frame, and so the reference and the pool, in its callers' variables."""
    caller = sys._getframe()
    while not {"frame", "clip"} <= set(caller.f_locals):
        caller = caller.f_back
    return caller.f_locals["frame"]


def subtract_blocks(image):
    """Without padding, which odd sizes need."""
    return image - F.interpolate(F.avg_pool2d(image, 2), scale_factor=2)


def mix_precisions(image, samples):
    """Under autocast a matrix product is bfloat16, and the image it is mixed with float32."""
    return torch.lerp(image, image @ torch.eye(image.shape[-1]), 0.5)


def divide_by_zero(image, samples):
    """At one size only; otherwise it would fail without samples or motion as well."""
    return image / (0.0 if samples.counts.shape[-1] == SIZE.w else 1.0)


class LargePadding(Correct):
    def denoise(self, gbuffer, samples, state):
        padded = F.pad(samples.mean, (16, 16, 16, 16), mode="reflect")
        image = padded[..., 16:-16, 16:-16]
        return super().denoise(gbuffer, SimpleNamespace(mean=image), state)


class ImageAlone(Correct):
    def denoise(self, gbuffer, samples, state):
        return super().denoise(gbuffer, samples, state)[0]


class WritesState(Correct):
    def denoise(self, gbuffer, samples, state):
        result = super().denoise(gbuffer, samples, state)
        if state is not None:
            state.mul_(0.5)
        return result


class StateWithGraph(Correct):
    def plan(self, gbuffer, samples, state):
        return super().plan(gbuffer, samples, None if state is None else state["image"][0].detach())

    def denoise(self, gbuffer, samples, state):
        image, _ = super().denoise(gbuffer, samples, None if state is None else state["image"][0])
        return image.detach(), {"image": [image * torch.ones(1, requires_grad=True)]}


class CountsCalls(Correct):
    """Memory in the method itself that nothing resets."""

    def denoise(self, gbuffer, samples, state):
        self.hidden["calls"] = self.hidden.get("calls", 0) + 1
        image, state = super().denoise(gbuffer, samples, state)
        return image + 1e-3 * self.hidden["calls"], state


class SharedMemory(Correct):
    """History in the method itself: reset at the start of a clip, but shared by all clips."""

    def start(self, size):
        self.hidden.clear()

    def plan(self, gbuffer, samples, state):
        self.hidden["history"] = self.hidden.get("image")
        return super().plan(gbuffer, samples, self.hidden["history"])

    def denoise(self, gbuffer, samples, state):
        image, self.hidden["image"] = super().denoise(gbuffer, samples, self.hidden["history"])
        return image, None


class IgnoresMotion(Correct):
    """Blends history without reprojection."""

    def denoise(self, gbuffer, samples, state):
        history = 0.0 if state is None else state
        image = (
            samples.mean + 0.5 * history + 0 * reproject_or_fill(samples.mean, gbuffer.motion, 0.0)
        )
        return image, image


class StateIsHandle(Correct):
    """Memory in the method itself, with a key to it as the state."""

    def start(self, size):
        return Handle()

    def plan(self, gbuffer, samples, state):
        return super().plan(gbuffer, samples, self.hidden.get(state))

    def denoise(self, gbuffer, samples, state):
        image, memory = super().denoise(gbuffer, samples, self.hidden.get(state))
        after = Handle()
        self.hidden[after] = memory
        return image, after


class UncopyableState(Correct):
    def denoise(self, gbuffer, samples, state):
        image, _ = super().denoise(gbuffer, samples, None if state is None else next(state))
        return image, (image for _ in count())

    def plan(self, gbuffer, samples, state):
        return super().plan(gbuffer, samples, None if state is None else next(state))


class Fault(NamedTuple):
    """The check that must fail, a function that builds the method, and its declared traits."""

    check: str
    build: Callable[[Traits], Any]
    traits: Traits = CORRECT


FAULTS = {
    "other traits": Fault("built", lambda traits: Correct(replace(traits, min_samples=1))),
    "not a method": Fault("built", lambda traits: SimpleNamespace(traits=traits)),
    "asks for a value": Fault(
        "recordable", edited(lambda image, samples: image if samples.counts.any() else 0 * image)
    ),
    "copies a number": Fault("recordable", edited(lambda image, samples: image * torch.tensor(1))),
    "not frozen": Fault(
        "frozen",
        lambda traits: SimpleNamespace(
            traits=traits, start=Correct().start, plan=Correct().plan, denoise=Correct().denoise
        ),
    ),
    "returns an image alone": Fault("returns", ImageAlone),
    "fails at odd sizes": Fault("odd_size", stateless(subtract_blocks), LOCAL),
    "crops odd sizes": Fault("odd_size", stateless(lambda image: image[..., :-1, :-1]), LOCAL),
    "pads by more than the frame": Fault("tiny_size", LargePadding),
    "double precision": Fault("image", edited(lambda image, samples: image.double())),
    "NaN or infinite image": Fault("image", edited(divide_by_zero)),
    "mixes precisions": Fault("half_precision", edited(mix_precisions)),
    "a negative density": Fault("density", changed(redirect=lambda density: density - 0.3)),
    "no density": Fault("density", changed(redirect=lambda density: None)),
    "adapts without declaring it": Fault("uniform", Correct, replace(CORRECT, adaptive=False)),
    "reads an undeclared input": Fault("inputs", changed(touch=lambda g, s: g.depth)),
    "declares an unread input": Fault(
        "inputs", Correct, replace(CORRECT, inputs=CORRECT.inputs | {"normal"})
    ),
    "writes to samples": Fault("in_place", changed(touch=lambda g, s: s.radiance.clamp_(max=10))),
    "writes to the G-buffer": Fault(
        "in_place", changed(touch=lambda g, s: g.albedo.clamp_(0.1, 1))
    ),
    "writes to its state": Fault("in_place", WritesState),
    "an image with a graph": Fault(
        "autograd", edited(lambda image, samples: image * torch.ones(1, requires_grad=True))
    ),
    "a state with a graph": Fault(
        "autograd", StateWithGraph, replace(CORRECT, inputs=frozenset({"albedo", "motion"}))
    ),
    "draws half of its budget": Fault(
        "budget", Correct, UncheckedTraits(CORRECT.inputs, "path", True, True, passes=(0.5,))
    ),
    "max_samples below its budgets": Fault("spp_range", Correct, replace(CORRECT, max_samples=4)),
    "min_samples above its budgets": Fault("odd_size", Correct, replace(CORRECT, min_samples=1)),
    "divides by sample counts": Fault(
        "zero_samples",
        edited(lambda image, samples: image + 0 * samples.counts / samples.counts.sum()),
    ),
    "needs eight samples in the pool": Fault(
        "small_pool", changed(touch=lambda g, s: s.radiance[:, 7])
    ),
    "random numbers without a seed": Fault(
        "determinism", edited(lambda image, samples: image + 1e-3 * torch.rand_like(image))
    ),
    "counts its calls": Fault("determinism", CountsCalls),
    "reads the reference": Fault(
        "leak", edited(lambda image, samples: image + read_frame().reference.mean)
    ),
    "reads undrawn samples": Fault(
        "leak", edited(lambda image, samples: image + read_frame().pool.radiance.mean(1))
    ),
    "normalises images over a batch": Fault(
        "batch", edited(lambda image, samples: image / image.amax().clamp_min(0.1))
    ),
    "normalises densities over a batch": Fault(
        "batch", changed(redirect=lambda density: density / density.amax())
    ),
    "shares memory between clips": Fault("interleaved", SharedMemory),
    "needs motion": Fault("static", changed(touch=lambda g, s: g.motion.abs())),
    "ignores motion at cuts": Fault("cut", IgnoresMotion),
    "temporal without declaring it": Fault("temporal", Correct, replace(CORRECT, temporal=False)),
    "a state that is a handle": Fault("state_copy", StateIsHandle),
    "an average over the image": Fault(
        "receptive_field",
        stateless(lambda image: image / image.amax((1, 2, 3), keepdim=True).clamp_min(0.1)),
        LOCAL,
    ),
    "a receptive field that is too small": Fault(
        "receptive_field",
        stateless(lambda image: F.avg_pool2d(image, 5, 1, 2)),
        replace(LOCAL, receptive_field=1),
    ),
    "a state that cannot be copied": Fault("state_copy", UncopyableState),
}

TRAITS = {"correct": CORRECT, "stateless": LOCAL}
TRAITS |= {name: fault.traits for name, fault in FAULTS.items()}


def build(variant, device, weights):
    if variant in FAULTS:
        return FAULTS[variant].build(FAULTS[variant].traits)
    return {"correct": Correct, "stateless": Stateless}[variant](TRAITS[variant])


FAMILY = Family(
    "faulty",
    "Methods with known faults",
    "Nobody 2026",
    "MIT",
    {name: Variant("Is it found?", traits, learned=False) for name, traits in TRAITS.items()},
    f"{__name__}:build",
)
