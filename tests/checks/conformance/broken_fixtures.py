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
class Edited(Correct):
    """Changes the image of the correct method, but not its state."""

    edit: Callable[..., Any] = lambda image, samples: image

    def denoise(self, gbuffer, samples, state):
        image, state = super().denoise(gbuffer, samples, state)
        return self.edit(image, samples), state


def edited(edit):
    return lambda traits: Edited(traits, edit=edit)


def mix_precisions(image, samples):
    """Under autocast a matrix product is bfloat16, and the image it is mixed with float32."""
    return torch.lerp(image, image @ torch.eye(image.shape[-1]), 0.5)


def divide_by_zero(image, samples):
    """At one size only; otherwise it would fail without samples or motion as well."""
    return image / (0.0 if samples.counts.shape[-1] == SIZE.w else 1.0)


class WithoutPadding(Correct):
    def denoise(self, gbuffer, samples, state):
        coarse = F.avg_pool2d(samples.mean, 2)
        return samples.mean - F.interpolate(coarse, scale_factor=2), None


class Crops(WithoutPadding):
    """Returns a cropped image instead of raising an error."""

    def denoise(self, gbuffer, samples, state):
        return samples.mean[..., :-1, :-1], None


class LargePadding(Correct):
    def denoise(self, gbuffer, samples, state):
        padded = F.pad(samples.mean, (16, 16, 16, 16), mode="reflect")
        image = padded[..., 16:-16, 16:-16]
        return super().denoise(gbuffer, replace_mean(samples, image), state)


class ImageAlone(Correct):
    def denoise(self, gbuffer, samples, state):
        return super().denoise(gbuffer, samples, state)[0]


class NegativeDensity(Correct):
    def plan(self, gbuffer, samples, state):
        return super().plan(gbuffer, samples, state) - 0.3


class NoDensity(Correct):
    def plan(self, gbuffer, samples, state):
        super().plan(gbuffer, samples, state)


class ReadsUndeclaredInput(Correct):
    def denoise(self, gbuffer, samples, state):
        gbuffer.depth  # noqa: B018
        return super().denoise(gbuffer, samples, state)


class WritesSamples(Correct):
    def denoise(self, gbuffer, samples, state):
        samples.radiance.clamp_(max=10)
        return super().denoise(gbuffer, samples, state)


class WritesGBuffer(Correct):
    def denoise(self, gbuffer, samples, state):
        gbuffer.albedo.clamp_(0.1, 0.9)
        return super().denoise(gbuffer, samples, state)


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


class NeedsEightSamples(Correct):
    def denoise(self, gbuffer, samples, state):
        samples.radiance[:, 7]
        return super().denoise(gbuffer, samples, state)


class CountsCalls(Correct):
    """Memory in the method itself that nothing resets."""

    def denoise(self, gbuffer, samples, state):
        self.hidden["calls"] = self.hidden.get("calls", 0) + 1
        image, state = super().denoise(gbuffer, samples, state)
        return image + 1e-3 * self.hidden["calls"], state


class ReadsReference(Correct):
    """Finds the frame, and so the reference, in its callers' variables."""

    def denoise(self, gbuffer, samples, state):
        image, state = super().denoise(gbuffer, samples, state)
        return image + self.read_frame(sys._getframe()), state

    def read_frame(self, caller):
        while not {"frame", "clip"} <= set(caller.f_locals):
            caller = caller.f_back
        return self.secret(caller.f_locals["frame"])

    def secret(self, frame):
        return frame.reference.mean


class ReadsPool(ReadsReference):
    def secret(self, frame):
        return frame.pool.radiance.mean(1)


class NormalisesDensityByBatch(Correct):
    def plan(self, gbuffer, samples, state):
        density = super().plan(gbuffer, samples, state)
        return density / density.amax()


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


class NeedsMotion(Correct):
    def denoise(self, gbuffer, samples, state):
        gbuffer.motion.abs()
        return super().denoise(gbuffer, samples, state)


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


def replace_mean(samples, image):
    """Samples with another mean."""
    return SimpleNamespace(mean=image)


class DividesByTheBrightest(Stateless):
    """Declares that a pixel depends on itself alone, and divides by the image's brightest one."""

    def denoise(self, gbuffer, samples, state):
        image, _ = super().denoise(gbuffer, samples, state)
        return image / image.amax((1, 2, 3), keepdim=True).clamp_min(0.1), None


class LooksFarther(Stateless):
    """Declares a smaller radius than that of its filter."""

    def denoise(self, gbuffer, samples, state):
        image, _ = super().denoise(gbuffer, samples, state)
        return F.avg_pool2d(image, 5, 1, 2), None


class Fault(NamedTuple):
    """The check that must fail, a function that builds the method, and its declared traits."""

    check: str
    build: Callable[[Traits], Any]
    traits: Traits = CORRECT


def ask(image, samples):
    return image if samples.counts.max() > 0 else 0 * image


def copy_number(image, samples):
    return image * torch.tensor(1.0)


FAULTS = {
    "other traits": Fault("built", lambda traits: Correct(replace(traits, min_samples=1))),
    "not a method": Fault("built", lambda traits: SimpleNamespace(traits=traits)),
    "asks for a value": Fault("recordable", edited(ask)),
    "copies a number": Fault("recordable", edited(copy_number)),
    "not frozen": Fault(
        "frozen",
        lambda traits: SimpleNamespace(
            traits=traits, start=Correct().start, plan=Correct().plan, denoise=Correct().denoise
        ),
    ),
    "returns an image alone": Fault("returns", ImageAlone),
    "fails at odd sizes": Fault("odd_size", WithoutPadding),
    "crops odd sizes": Fault("odd_size", Crops),
    "pads by more than the frame": Fault("tiny_size", LargePadding),
    "double precision": Fault("image", edited(lambda image, samples: image.double())),
    "NaN or infinite image": Fault("image", edited(divide_by_zero)),
    "mixes precisions": Fault("half_precision", edited(mix_precisions)),
    "a negative density": Fault("density", NegativeDensity),
    "no density": Fault("density", NoDensity),
    "adapts without declaring it": Fault("uniform", Correct, replace(CORRECT, adaptive=False)),
    "reads an undeclared input": Fault("inputs", ReadsUndeclaredInput),
    "declares an unread input": Fault(
        "inputs", Correct, replace(CORRECT, inputs=CORRECT.inputs | {"normal"})
    ),
    "writes to samples": Fault("in_place", WritesSamples),
    "writes to the G-buffer": Fault("in_place", WritesGBuffer),
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
    "needs eight samples in the pool": Fault("small_pool", NeedsEightSamples),
    "random numbers without a seed": Fault(
        "determinism", edited(lambda image, samples: image + 1e-3 * torch.rand_like(image))
    ),
    "counts its calls": Fault("determinism", CountsCalls),
    "reads the reference": Fault("leak", ReadsReference),
    "reads undrawn samples": Fault("leak", ReadsPool),
    "normalises images over a batch": Fault(
        "batch", edited(lambda image, samples: image / image.amax().clamp_min(0.1))
    ),
    "normalises densities over a batch": Fault("batch", NormalisesDensityByBatch),
    "shares memory between clips": Fault("interleaved", SharedMemory),
    "needs motion": Fault("static", NeedsMotion),
    "ignores motion at cuts": Fault("cut", IgnoresMotion),
    "temporal without declaring it": Fault("temporal", Correct, replace(CORRECT, temporal=False)),
    "a state that is a handle": Fault("state_copy", StateIsHandle),
    "an average over the image": Fault("receptive_field", DividesByTheBrightest, LOCAL),
    "a receptive field that is too small": Fault(
        "receptive_field", LooksFarther, replace(LOCAL, receptive_field=1)
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
