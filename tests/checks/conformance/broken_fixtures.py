"""Tiny methods, each with one fault, and the claim that must find it."""

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

SIZE, LESSER = Size(1, 19, 31), Size(1, 17, 23)  # pixels: faults are as plain in small frames
SOUND = Traits(inputs=frozenset({"albedo", "motion"}), adaptive=True, temporal=True)


@dataclass(frozen=True)
class Sound:
    """A method without fault, of which each fault replaces a part: half of it is its history."""

    traits: Traits = SOUND
    box: dict[str, Any] = field(default_factory=dict)  # where faulty ones hide their memory

    def start(self, size):
        return None

    def plan(self, gbuffer, samples, state):
        light = gbuffer.albedo.mean(1, keepdim=True) + 0.1
        return (
            light
            if state is None
            else light + reproject_or_fill(state, gbuffer.motion, 0.0).mean(1, True)
        )

    def denoise(self, gbuffer, samples, state):
        history = 0.0 if state is None else reproject_or_fill(state, gbuffer.motion, 0.0)
        image = samples.mean + 0.5 * history
        return image, image


@dataclass(frozen=True)
class Careless(Traits):
    """Traits that are not checked when they are made."""

    def __post_init__(self):
        pass


class Handle:
    """A state that says where the memory is, and holds none."""


@dataclass(frozen=True)
class Still(Sound):
    """The same without memory and without a wish."""

    def plan(self, gbuffer, samples, state):
        return torch.ones_like(gbuffer.albedo[:, :1])

    def denoise(self, gbuffer, samples, state):
        return samples.mean + 0 * gbuffer.albedo, None


class WithoutPadding(Sound):
    def denoise(self, gbuffer, samples, state):
        coarse = F.avg_pool2d(samples.mean, 2)
        return samples.mean - F.interpolate(coarse, scale_factor=2), None


class UnpaddedLater(WithoutPadding):
    """Shows what is left of a frame, instead of stopping."""

    def denoise(self, gbuffer, samples, state):
        return samples.mean[..., :-1, :-1], None


class LargePadding(Sound):
    def denoise(self, gbuffer, samples, state):
        padded = F.pad(samples.mean, (16, 16, 16, 16), mode="reflect")
        image = padded[..., 16:-16, 16:-16]
        return super().denoise(gbuffer, replace_mean(samples, image), state)


class InDouble(Sound):
    def denoise(self, gbuffer, samples, state):
        image, state = super().denoise(gbuffer, samples, state)
        return image.double(), state


class NotFinite(Sound):
    """Of one size alone, for else it would not run without samples or motion either."""

    def denoise(self, gbuffer, samples, state):
        image, state = super().denoise(gbuffer, samples, state)
        bad = samples.counts.shape[-1] == SIZE.w
        return image / (0.0 if bad else 1.0), state


class Negative(Sound):
    def plan(self, gbuffer, samples, state):
        return super().plan(gbuffer, samples, state) - 0.3


class Unplanned(Sound):
    def plan(self, gbuffer, samples, state):
        super().plan(gbuffer, samples, state)


class MixesPrecisions(Sound):
    """Under autocast a product of matrices is of half precision, and what it is mixed with not."""

    def denoise(self, gbuffer, samples, state):
        image, state = super().denoise(gbuffer, samples, state)
        return torch.lerp(image, image @ torch.eye(image.shape[-1]), 0.5), state


class ReadsMore(Sound):
    def denoise(self, gbuffer, samples, state):
        gbuffer.depth  # noqa: B018
        return super().denoise(gbuffer, samples, state)


class WritesSamples(Sound):
    def denoise(self, gbuffer, samples, state):
        samples.radiance.clamp_(max=10)
        return super().denoise(gbuffer, samples, state)


class WritesView(Sound):
    def denoise(self, gbuffer, samples, state):
        gbuffer.albedo.clamp_(0.1, 0.9)
        return super().denoise(gbuffer, samples, state)


class WritesState(Sound):
    def denoise(self, gbuffer, samples, state):
        shown = super().denoise(gbuffer, samples, state)
        if state is not None:
            state.mul_(0.5)
        return shown


class Trainable(Sound):
    def denoise(self, gbuffer, samples, state):
        image, state = super().denoise(gbuffer, samples, state)
        return image * torch.ones(1, requires_grad=True), state


class RemembersGraph(Sound):
    def plan(self, gbuffer, samples, state):
        return super().plan(gbuffer, samples, None if state is None else state["held"][0].detach())

    def denoise(self, gbuffer, samples, state):
        image, _ = super().denoise(gbuffer, samples, None if state is None else state["held"][0])
        return image.detach(), {"held": [image * torch.ones(1, requires_grad=True)]}


class NeedsOne(Sound):
    def denoise(self, gbuffer, samples, state):
        share = samples.counts / samples.counts.sum()
        image, state = super().denoise(gbuffer, samples, state)
        return image + 0 * share, state


class EightSlots(Sound):
    def denoise(self, gbuffer, samples, state):
        samples.radiance[:, 7]
        return super().denoise(gbuffer, samples, state)


class Dice(Sound):
    def denoise(self, gbuffer, samples, state):
        image, state = super().denoise(gbuffer, samples, state)
        return image + 1e-3 * torch.rand_like(image), state


class Remembers(Sound):
    """History that is never forgotten, in the method itself."""

    def denoise(self, gbuffer, samples, state):
        self.box["calls"] = self.box.get("calls", 0) + 1
        image, state = super().denoise(gbuffer, samples, state)
        return image + 1e-3 * self.box["calls"], state


class Peeks(Sound):
    """Finds the frame, and so the reference, in its callers' variables."""

    def denoise(self, gbuffer, samples, state):
        image, state = super().denoise(gbuffer, samples, state)
        return image + self.found(sys._getframe()), state

    def found(self, caller):
        while not {"frame", "clip"} <= set(caller.f_locals):
            caller = caller.f_back
        return self.wanted(caller.f_locals["frame"])

    def wanted(self, frame):
        return frame.reference.mean


class PeeksPool(Peeks):
    def wanted(self, frame):
        return frame.pool.radiance.mean(1)


class ExposesAll(Sound):
    """Normalised by the brightest pixel of all images at once."""

    def denoise(self, gbuffer, samples, state):
        image, state = super().denoise(gbuffer, samples, state)
        return image / image.amax().clamp_min(0.1), state


class PlansForAll(Sound):
    def plan(self, gbuffer, samples, state):
        wish = super().plan(gbuffer, samples, state)
        return wish / wish.amax()


class OneMemory(Sound):
    """History in the method itself: forgotten where a clip starts, but shared by all clips."""

    def start(self, size):
        self.box.clear()

    def plan(self, gbuffer, samples, state):
        self.box["history"] = self.box.get("shown")
        return super().plan(gbuffer, samples, self.box["history"])

    def denoise(self, gbuffer, samples, state):
        image, self.box["shown"] = super().denoise(gbuffer, samples, self.box["history"])
        return image, None


class NeedsMotion(Sound):
    def denoise(self, gbuffer, samples, state):
        gbuffer.motion.abs()
        return super().denoise(gbuffer, samples, state)


class Lingers(Sound):
    """Blends without moving."""

    def denoise(self, gbuffer, samples, state):
        history = 0.0 if state is None else state
        image = (
            samples.mean + 0.5 * history + 0 * reproject_or_fill(samples.mean, gbuffer.motion, 0.0)
        )
        return image, image


class Elsewhere(Sound):
    """Memory by handle."""

    def start(self, size):
        return Handle()

    def plan(self, gbuffer, samples, state):
        return super().plan(gbuffer, samples, self.box.get(state))

    def denoise(self, gbuffer, samples, state):
        image, memory = super().denoise(gbuffer, samples, self.box.get(state))
        after = Handle()
        self.box[after] = memory
        return image, after


class Uncopied(Sound):
    def denoise(self, gbuffer, samples, state):
        image, _ = super().denoise(gbuffer, samples, None if state is None else next(state))
        return image, (image for _ in count())

    def plan(self, gbuffer, samples, state):
        return super().plan(gbuffer, samples, None if state is None else next(state))


def replace_mean(samples, image):
    """Samples of which the mean is another one."""
    return SimpleNamespace(mean=image)


class Fault(NamedTuple):
    """The claim that must find it, what is built, and what is declared if not the same."""

    claim: str
    build: Callable[[Traits], Any]
    traits: Traits = SOUND


FAULTS = {
    "other traits": Fault("built", lambda traits: Sound(replace(traits, min_samples=1))),
    "no method at all": Fault("built", lambda traits: SimpleNamespace(traits=traits)),
    "can be written to": Fault(
        "frozen",
        lambda traits: SimpleNamespace(
            traits=traits, start=Sound().start, plan=Sound().plan, denoise=Sound().denoise
        ),
    ),
    "odd sides do not fit": Fault("runs", WithoutPadding),
    "odd sides are cropped": Fault("runs", UnpaddedLater),
    "pads more than there is": Fault("small", LargePadding),
    "double precision": Fault("image", InDouble),
    "not finite": Fault("image", NotFinite),
    "mixes precisions": Fault("half", MixesPrecisions),
    "a negative density": Fault("density", Negative),
    "no density": Fault("density", Unplanned),
    "adapts in secret": Fault("uniform", Sound, replace(SOUND, adaptive=False)),
    "reads what it did not declare": Fault("reads", ReadsMore),
    "declares what it does not read": Fault(
        "reads", Sound, replace(SOUND, inputs=SOUND.inputs | {"normal"})
    ),
    "writes to samples": Fault("inputs", WritesSamples),
    "writes to the view": Fault("inputs", WritesView),
    "writes to its state": Fault("inputs", WritesState),
    "an image with a graph": Fault("graph", Trainable),
    "a state with a graph": Fault(
        "graph", RemembersGraph, replace(SOUND, inputs=frozenset({"albedo", "motion"}))
    ),
    "buys half": Fault("budget", Sound, Careless(SOUND.inputs, "path", True, True, passes=(0.5,))),
    "a cap below its range": Fault("spread", Sound, replace(SOUND, max_samples=4)),
    "a floor above its range": Fault("runs", Sound, replace(SOUND, min_samples=1)),
    "divides by what it bought": Fault("nothing", NeedsOne),
    "wants eight slots": Fault("fewer", EightSlots),
    "draws without a seed": Fault("repeats", Dice),
    "never forgets": Fault("repeats", Remembers),
    "peeks at the reference": Fault("leak", Peeks),
    "peeks at unbought samples": Fault("leak", PeeksPool),
    "exposes a batch as one": Fault("batch", ExposesAll),
    "plans for a batch as one": Fault("batch", PlansForAll),
    "remembers one clip": Fault("alone", OneMemory),
    "needs motion": Fault("static", NeedsMotion),
    "lingers after a cut": Fault("cut", Lingers),
    "temporal in secret": Fault("temporal", Sound, replace(SOUND, temporal=False)),
    "remembers by handle": Fault("replay", Elsewhere),
    "a state that cannot be copied": Fault("replay", Uncopied),
}

TRAITS = {
    "sound": SOUND,
    "still": replace(SOUND, adaptive=False, temporal=False, inputs=frozenset({"albedo"})),
}
TRAITS |= {name: fault.traits for name, fault in FAULTS.items()}


def build(variant, device, weights):
    if variant in FAULTS:
        return FAULTS[variant].build(FAULTS[variant].traits)
    return {"sound": Sound, "still": Still}[variant](TRAITS[variant])


FAMILY = Family(
    "plants",
    "Planted faults",
    "Nobody 2026",
    "MIT",
    {name: Variant("Is it found?", traits, learned=False) for name, traits in TRAITS.items()},
    f"{__name__}:build",
)
