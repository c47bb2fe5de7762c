"""Tiny methods, each with one fault under stress, and the results of a section for them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch.nn import functional as F

from rlbench import registry
from rlbench.checks.result import CheckResult, Verdict
from rlbench.checks.stress.section import StressedMethod, load_stressed_method
from rlbench.family import Traits
from rlbench.ops.reprojection import reproject
from tests.conftest import write_plugin

TEMPORAL = Traits(inputs=frozenset({"motion"}), temporal=True)


@dataclass(frozen=True)
class Mean:
    """The mean of the samples."""

    traits: Traits = Traits()
    hidden: dict[str, Any] = field(default_factory=dict)  # memory outside the state

    def start(self, size):
        return None

    def plan(self, gbuffer, samples, state):
        return torch.ones_like(samples.counts, dtype=torch.float32)

    def denoise(self, gbuffer, samples, state):
        return samples.mean, None


@dataclass(frozen=True)
class Accumulate(Mean):
    """The mean of all samples, reprojected: it converges on a static camera."""

    traits: Traits = TEMPORAL
    max_frames: float = float("inf")

    def denoise(self, gbuffer, samples, state):
        total, frames = self.reproject(state, gbuffer) if state else (0.0, 0.0)
        frames = torch.as_tensor(frames).clamp_max(self.max_frames - 1)
        image = (total * frames + samples.mean) / (frames + 1)
        return image, (image, torch.zeros_like(samples.mean[:, :1]) + frames + 1)

    def reproject(self, state, gbuffer):
        image, frames = state
        warped, valid = reproject(torch.cat((image, frames), 1), gbuffer.motion)
        warped = warped.where(valid, 0.0)
        return warped[:, :3], warped[:, 3:]


class NeverConverges(Accumulate):
    """Averages over eight frames, however long the camera rests."""

    def __init__(self):
        super().__init__(max_frames=8.0)


class Remembers(Accumulate):
    """Keeps one thing more than its image, and changes the image by it; by default its age."""

    def denoise(self, gbuffer, samples, state):
        image, after = super().denoise(gbuffer, samples, state and state[:2])
        image, kept = self.remember(image, samples, state[2] if state else 0)
        return image, (*after, kept)


class Drifts(Remembers):
    """Gets darker by 1 % with every frame."""

    def remember(self, image, samples, age):
        return image * 0.99**age, age + 1


class LosesFrames(Remembers):
    """Twelve frames of the moving clip in the middle of a run are `lost`."""

    def __init__(self, lost):
        super().__init__(hidden={"lost": lost})

    def remember(self, image, samples, age):
        if 125 <= age < 137 and len(image) > 1:
            image = torch.cat((image[:1], torch.full_like(image[1:], self.hidden["lost"])))
        return image, age + 1


class GrowsState(Remembers):
    """Keeps one number per frame in its state."""

    def remember(self, image, samples, brightness):
        return image, (*(brightness or ()), float(image.mean()))


class Overflows(Remembers):
    """Sums squared radiance without an end, scaled as no half float can hold it."""

    def remember(self, image, samples, energy):
        return image, 1e4 * samples.mean.square() + energy


class GrowsMemory(Remembers):
    """Keeps every image outside its state."""

    def remember(self, image, samples, age):
        self.hidden[len(self.hidden)] = image
        return image, age


class ForgetsToDeclare(Mean):
    """Fades with every frame by a state that its traits deny."""

    def denoise(self, gbuffer, samples, state):
        age = state or 0
        return samples.mean * 0.99**age, age + 1


class RemembersOutside(Mean):
    """Fades with every frame by memory outside its state."""

    def denoise(self, gbuffer, samples, state):
        self.hidden["age"] = self.hidden.get("age", 0) + 1
        return samples.mean * 0.99 ** self.hidden["age"], None


class TrustsMotion(Accumulate):
    """Reads history from wherever motion points, also from outside the image, and by any surface.

    It never doubts its history.
    """

    def reproject(self, state, gbuffer):
        image, frames = state
        warped, _ = reproject(torch.cat((image, frames), 1), gbuffer.motion)
        return warped[:, :3], warped[:, 3:]


def columns(samples):
    return torch.arange(samples.mean.shape[-1])


def rows(samples):
    return torch.arange(samples.mean.shape[-2])[:, None]


def reject_blue(gbuffer, samples):
    red, _, blue = samples.mean.split(1, 1)
    return samples.mean.where(blue <= red, 0.0)


def reject_bright(gbuffer, samples):
    if samples.radiance.amax() > 6e4:
        raise ArithmeticError("too bright")
    return samples.mean


def filter_irradiance(gbuffer, samples):
    """Divides by albedo and multiplies by it: every lie about albedo is in the image."""
    irradiance = samples.mean / gbuffer.albedo.clamp_min(0.01)
    image = F.avg_pool2d(irradiance, 5, 1, 2) * gbuffer.albedo
    return torch.where(gbuffer.albedo.sum(1, True) > 0, image, samples.mean)


def reject_black_albedo(gbuffer, samples):
    if not gbuffer.albedo.flatten(1).any(1).all():  # negative values are repaired to zero
        raise ValueError("black albedo")
    return filter_irradiance(gbuffer, samples)


def amplify_rounding(gbuffer, samples):
    """A matrix product, which autocast rounds, amplifies its rounding."""
    image = samples.mean
    rounded = image @ torch.eye(image.shape[-1]).to(image)
    return image + 200 * (rounded.to(image) - image)


IMAGES = {  # of the G-buffer and the samples
    "DependsOnExposure": lambda g, s: replace(s, radiance=s.radiance.clamp_max(10.0)).mean,
    "AddsLight": lambda g, s: s.mean + 0.01,  # visible in black
    "RejectsBlue": reject_blue,  # black where blue is above red, as in the sky
    "RejectsBright": reject_bright,
    "PrefersRight": lambda g, s: s.mean * (columns(s) >= len(columns(s)) // 2),
    "PrefersTop": lambda g, s: s.mean * (rows(s) < len(rows(s)) // 2),
    "Tiles": lambda g, s: s.mean * (columns(s) // 16 % 2),  # every second is black
    "FirstSample": lambda g, s: s.radiance[:, 0],
    "DividesByBatch": lambda g, s: s.mean / s.mean.amax(),
    "Unseeded": lambda g, s: s.mean + 0.01 * torch.rand_like(s.mean),
    "DependsOnThreads": lambda g, s: s.mean / torch.get_num_threads(),
    "Cancels": lambda g, s: (s.mean + 3e7) - 3e7,  # all digits of float32
    "CancelsInHalf": amplify_rounding,
    "NeedsFloat32": lambda g, s: s.mean @ torch.eye(s.mean.shape[-1], dtype=torch.float32),
    # the brightest sample sets the exposure of the whole image
    "ExposedByMaximum": lambda g, s: s.mean / s.mean.amax((1, 2, 3), keepdim=True),
    "WideBlur": lambda g, s: F.avg_pool2d(s.mean, 25, 1, 12),
    "DividingByDepth": lambda g, s: s.mean * g.depth.nan_to_num(posinf=0).mean(),
    "MisusesAlbedo": lambda g, s: 2 * s.mean * g.albedo,  # which is in the samples already
    "IgnoresAlbedo": lambda g, s: s.mean + 0 * g.albedo,
    "CopiesAlbedo": filter_irradiance,
    "RejectsBlackAlbedo": reject_black_albedo,
}


def stateless(name: str) -> Mean:
    """A method without state of this image, which declares the input in its name."""
    inputs = frozenset(each for each in ("albedo", "depth") if each.title() in name)
    denoise = {"denoise": lambda self, g, s, state: (IMAGES[name](g, s), None)}
    return type(name, (Mean,), denoise)(Traits(inputs=inputs))


STATELESS = {name: stateless(name) for name in IMAGES}


@dataclass(frozen=True)
class AveragesBlindly(Mean):
    """An exponential average that never looks at what it keeps."""

    traits: Traits = TEMPORAL

    def start(self, size):
        return torch.zeros(size.n, 3, size.h, size.w)

    def denoise(self, gbuffer, samples, state):
        image = torch.lerp(state, samples.mean, 0.5)
        return image, image


@dataclass(frozen=True)
class AvoidsTheBrightest(Mean):
    """After a very bright sample the left half of the image gets no samples."""

    traits: Traits = Traits(adaptive=True, temporal=True)

    def start(self, size):
        return torch.ones(size.n, 1, size.h, size.w)

    def plan(self, gbuffer, samples, state):
        return state

    def denoise(self, gbuffer, samples, state):
        density = torch.ones_like(state)
        if samples.mean.amax() > 2e4:
            density[..., : density.shape[-1] // 2] = 0
        return samples.mean, density


def run_section(section, method, is_quick=True, device="cpu") -> dict[str, CheckResult]:
    """The results of a section for a method, by the name of the test."""
    stressed = StressedMethod(type(method).__name__, method, torch.device(device))
    return {result.check: result for result in section.run(stressed, is_quick)}


def verdicts(section, method, is_quick=True, device="cpu") -> dict[str, Verdict]:
    """The verdicts of a section for a method, by the name of the test."""
    results = run_section(section, method, is_quick, device)
    return {test: result.verdict for test, result in results.items()}


def stressed_toy(folder: Path, body: str = "", traits: str = "") -> StressedMethod:
    """A method `toy` of a plugin that averages its samples, or whose denoiser runs `body`."""
    file = write_plugin(folder / "toy.py", "toy", traits=traits, **({"body": body} if body else {}))
    registry.use_plugin(file)
    return load_stressed_method("toy", torch.device("cpu"))
