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


class Drifts(Accumulate):
    """Gets darker by 1 % with every frame."""

    def denoise(self, gbuffer, samples, state):
        age = 0 if state is None else state[2]
        image, after = super().denoise(gbuffer, samples, state and state[:2])
        return image * 0.99**age, (*after, age + 1)


class GrowsState(Accumulate):
    """Keeps one number per frame in its state."""

    def denoise(self, gbuffer, samples, state):
        image, after = super().denoise(gbuffer, samples, state and state[:2])
        brightness = (*(state[2] if state else ()), float(image.mean()))
        return image, (*after, brightness)


class GrowsMemory(Accumulate):
    """Keeps every image outside its state."""

    def denoise(self, gbuffer, samples, state):
        image, after = super().denoise(gbuffer, samples, state)
        self.hidden.setdefault("images", []).append(image)
        return image, after


class Overflows(Accumulate):
    """Sums squared radiance without an end, scaled as no half float can hold it."""

    def denoise(self, gbuffer, samples, state):
        image, after = super().denoise(gbuffer, samples, state and state[:2])
        energy = 1e4 * samples.mean.square() + (state[2] if state else 0.0)
        return image, (*after, energy)


class TrustsMotion(Accumulate):
    """Reads history from wherever motion points, also from outside the image, and by any surface.

    It never doubts its history.
    """

    def reproject(self, state, gbuffer):
        image, frames = state
        warped, _ = reproject(torch.cat((image, frames), 1), gbuffer.motion)
        return warped[:, :3], warped[:, 3:]


class DependsOnExposure(Mean):
    """Clamps samples at 10."""

    def denoise(self, gbuffer, samples, state):
        return replace(samples, radiance=samples.radiance.clamp_max(10.0)).mean, None


class AddsLight(Mean):
    """Adds a little light, which is visible in black."""

    def denoise(self, gbuffer, samples, state):
        return samples.mean + 0.01, None


class RejectsBlue(Mean):
    """Returns black where blue is above red, as in the sky."""

    def denoise(self, gbuffer, samples, state):
        red, _, blue = samples.mean.split(1, 1)
        return samples.mean.where(blue <= red, 0.0), None


class PrefersRight(Mean):
    """Returns black in the left half."""

    def denoise(self, gbuffer, samples, state):
        w = samples.mean.shape[-1]
        return samples.mean * (torch.arange(w) >= w // 2), None


class PrefersTop(Mean):
    """Returns black in the lower half."""

    def denoise(self, gbuffer, samples, state):
        h = samples.mean.shape[-2]
        return samples.mean * (torch.arange(h) < h // 2)[:, None], None


class Tiles(Mean):
    """Returns black in every second tile of 16 pixels."""

    def denoise(self, gbuffer, samples, state):
        column = torch.arange(samples.mean.shape[-1]) // 16 % 2
        return samples.mean * column, None


class FirstSample(Mean):
    """Ignores all samples but the first."""

    def denoise(self, gbuffer, samples, state):
        return samples.radiance[:, 0], None


class DividesByBatch(Mean):
    """Normalises by the brightest pixel of the batch."""

    def denoise(self, gbuffer, samples, state):
        return samples.mean / samples.mean.amax(), None


class Unseeded(Mean):
    """Draws random numbers without a seed."""

    def denoise(self, gbuffer, samples, state):
        return samples.mean + 0.01 * torch.rand_like(samples.mean), None


class DependsOnThreads(Mean):
    """Computes something else with each number of threads."""

    def denoise(self, gbuffer, samples, state):
        return samples.mean / torch.get_num_threads(), None


class Cancels(Mean):
    """Loses all digits of float32 by adding and subtracting a large number."""

    def denoise(self, gbuffer, samples, state):
        return (samples.mean + 3e7) - 3e7, None


class CancelsInHalf(Mean):
    """A matrix product, which autocast rounds, amplifies its rounding."""

    def denoise(self, gbuffer, samples, state):
        image = samples.mean
        rounded = image @ torch.eye(image.shape[-1]).to(image)
        return image + 200 * (rounded.to(image) - image), None


@dataclass(frozen=True)
class NeedsFloat32(Mean):
    """Multiplies by a float32 matrix that it creates itself, which fails in float64."""

    def denoise(self, gbuffer, samples, state):
        identity = torch.eye(samples.mean.shape[-1], dtype=torch.float32)
        return samples.mean @ identity, None


@dataclass(frozen=True)
class CopiesAlbedo(Mean):
    """Filters irradiance and multiplies by albedo: every lie about albedo is in the image."""

    traits: Traits = Traits(inputs=frozenset({"albedo"}))

    def denoise(self, gbuffer, samples, state):
        irradiance = samples.mean / gbuffer.albedo.clamp_min(0.01)
        image = F.avg_pool2d(irradiance, 5, 1, 2) * gbuffer.albedo
        return torch.where(gbuffer.albedo.sum(1, True) > 0, image, samples.mean), None


class RejectsBlackAlbedo(CopiesAlbedo):
    """Raises an exception for one lie."""

    def denoise(self, gbuffer, samples, state):
        if not gbuffer.albedo.flatten(1).any(1).all():  # negative values are repaired to zero
            raise ValueError("black albedo")
        return super().denoise(gbuffer, samples, state)


class MisusesAlbedo(CopiesAlbedo):
    """Multiplies by albedo, which the samples contain already."""

    def denoise(self, gbuffer, samples, state):
        return 2 * samples.mean * gbuffer.albedo, None


class IgnoresAlbedo(CopiesAlbedo):
    """Reads albedo without effect."""

    def denoise(self, gbuffer, samples, state):
        return samples.mean + 0 * gbuffer.albedo, None


class ExposedByMaximum(Mean):
    """The brightest sample sets the exposure of the whole image."""

    def denoise(self, gbuffer, samples, state):
        return samples.mean / samples.mean.amax((1, 2, 3), keepdim=True), None


class WideBlur(Mean):
    """A bad sample is spread over 25 x 25 pixels, for one frame."""

    def denoise(self, gbuffer, samples, state):
        return F.avg_pool2d(samples.mean, 25, 1, 12), None


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
class DividingByDepth(Mean):
    """A depth is used as a divisor of a sum over the image."""

    traits: Traits = Traits(inputs=frozenset({"depth"}))

    def denoise(self, gbuffer, samples, state):
        return samples.mean * gbuffer.depth.nan_to_num(posinf=0).mean(), None


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


class RejectsBright(Mean):
    """Raises an exception for a bright sample."""

    def denoise(self, gbuffer, samples, state):
        if samples.radiance.amax() > 6e4:
            raise ArithmeticError("too bright")
        return samples.mean, None


def run_section(section, method, is_quick=True) -> dict[str, CheckResult]:
    """The results of a section for a method, by the name of the test."""
    stressed = StressedMethod(type(method).__name__, method, torch.device("cpu"))
    return {result.check: result for result in section.run(stressed, is_quick)}


def verdicts(section, method, is_quick=True) -> dict[str, Verdict]:
    """The verdicts of a section for a method, by the name of the test."""
    results = run_section(section, method, is_quick)
    return {test: result.verdict for test, result in results.items()}


def stressed_toy(folder: Path, body: str = "", traits: str = "") -> StressedMethod:
    """A method `toy` of a plugin that averages its samples, or whose denoiser runs `body`."""
    file = write_plugin(folder / "toy.py", "toy", traits=traits, **({"body": body} if body else {}))
    registry.use_plugin(file)
    return load_stressed_method("toy", torch.device("cpu"))
