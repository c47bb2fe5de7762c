"""One frame of online cross-regression: pilots, screened history, filter, a step of learning."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from baselines.accumulate.density import contrast, mix_with_uniform
from baselines.cross import FAMILY
from baselines.cross.bilateral import filter_pilots
from baselines.cross.network import Learner, predict, random_weights
from baselines.cross.pilots import MAX_LOG, regress, split_halves
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.demodulation import surface_mask
from rlbench.ops.sanitize import repair_history, sanitize_radiance
from rlbench.ops.surface_taps import find_surface_taps
from rlbench.ops.transfer import log_forward
from rlbench.run import run_clip

MIN_NORMAL_COSINE = 0.9  # between the normals of one surface in two frames
SCREEN_SIDE = 7  # pixels, side of the window of pilots that the last frame must fit
WEIGHT_OFFSET = 1e-4  # added to sums of weights
LOSS_OFFSET = 1e-2  # added to the square of what a loss divides by
MAX_WEIGHT = 100.0  # of the network; a step changes a weight by little more than the rate
PASS_FRAMES, PASS_SIDE, PASS_SPP = 32, 64, 2.0  # of the clip whose weights `frozen` keeps


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants."""

    learning_rate: float = 1e-3  # of Adam; 0: the network stays as it begins
    starts_learned: bool = False  # begin with the weights of a pass over a procedural clip
    samples_by_contrast: bool = False  # more samples where the last image has contrast
    seed: int = 0  # of random weights


BASE = Config()
VARIANTS = {
    "": BASE,
    "pilots": BASE,
    "frozen": replace(BASE, learning_rate=0.0, starts_learned=True),  # what does learning give?
    "contrast": replace(BASE, samples_by_contrast=True),  # does following contrast gain?
    "restir": BASE,
}


class State(NamedTuple):
    """What is carried between frames; depth 0 means no surface, and no history there."""

    image: Float[Tensor, "n 3 h w"]  # last output, log(1 + radiance)
    pilots: Float[Tensor, "n 6 h w"]
    depth: Float[Tensor, "n 1 h w"]
    normal: Float[Tensor, "n 3 h w"]
    learner: Learner


class Screened(NamedTuple):
    """Last output and pilots as seen from this frame; current ones where they do not fit."""

    image: Float[Tensor, "n 3 h w"]
    pilots: Float[Tensor, "n 6 h w"]
    fits: Bool[Tensor, "n 1 h w"]  # True where `image` is the last output


@dataclass(frozen=True)
class Cross:
    """Online cross-regression (Choi et al. 2024), which learns on the frames that it denoises.

    The samples of a pixel are split into two halves, and the logarithm of each is predicted from
    the other by local linear regression (`baselines.cross.pilots`). A U-Net of 31,414 weights,
    random in the first frame, reads both pilots, the last output, albedo and normal, and predicts
    bandwidths of a cross-bilateral filter of both pilots, and the weight alpha of the new frame
    against the last output. The last output is reprojected, and rejected where no surface matches
    within 3 x 3 pixels or where it is outside the range of the pilots in 7 x 7 pixels. After each
    frame one step of Adam reduces the relative squared error of the filtered half A against pilot
    B, of B against A, and of each against its own pilot of the last frame. Uniform sampling.

    Constants, network, loss and the order of operations are those of the authors' code
    (github.com/CGLab-GIST/cross-denoiser, BSD-3-Clause), which was read; none of it was copied.

    As published, means are those of logarithms, so an image of noisy samples is too dark: in four
    generated scenes by 3 to 20 % at 2 spp, by 1 to 3 % at 8.

    Differs from it: a G-buffer holds no emission, so pixels without a surface, and emitters that
    reflect nothing, are returned as they are; in theirs emission is added after filtering, and
    here a surface that emits and reflects is filtered. Surfaces match within 10 % of depth and a
    cosine of normals of 0.9, without the authors' derivatives of depth and normals and without
    their search in 3 x 3 pixels. Fireflies are limited (rlbench.ops.limit_fireflies), by pixels of
    both halves, so the halves are not quite independent. Weights begin anew, like all history, in
    a clip of which no pixel has history. A gradient that is not finite makes no step, broken
    history is replaced by a neighbour, and predictions are at most the logarithm of a half float.
    Images that are no multiple of 4 are padded before the network. All of it is in single
    precision, also under autocast. In their input ReSTIR PT draws the samples; the pool of the
    variant `restir` is ReSTIR DI, whose samples are independent chains, so each half has its own.
    """

    initial: Float[Tensor, " p"]  # weights in the first frame
    config: Config = BASE
    traits: Traits = FAMILY.variants[""].traits

    def start(self, size: Size) -> State:
        """No history, and the network before its first step."""
        zeros = self.initial.new_zeros(size.n, 6, size.h, size.w)
        three, one = zeros[:, :3], zeros[:, :1]
        return State(three, zeros, one, three, Learner.begin(self.initial, size.n))

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """Uniform density, or that of `accumulate/contrast`."""
        if not self.config.samples_by_contrast:
            return torch.ones_like(gbuffer.depth)
        surface = _read_surface(gbuffer)
        image, _, known = _reproject(gbuffer, surface, state)
        return mix_with_uniform(contrast(_LogImage(log_forward(image.expm1()))), known.float())

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The image in linear radiance, and the state after a step of learning."""
        with torch.autocast(gbuffer.depth.device.type, enabled=False):
            surface = _read_surface(gbuffer)
            pilots = make_pilots(samples, surface)
            image, old_pilots, known = _reproject(gbuffer, surface, state)
            last = screen(pilots, image, old_pilots, known)
            learner = _restart(state.learner, self.initial, known)
            output, learner = self._learn(learner, pilots, last, surface)
            light = output.expm1().where(surface.mask, sanitize_radiance(samples.mean))
            return light, State(output, pilots, surface.depth, surface.normal, learner)

    def _learn(
        self, learner: Learner, pilots: Tensor, last: Screened, surface: Surface
    ) -> tuple[Float[Tensor, "n 3 h w"], Learner]:
        """The output in log(1 + radiance), and the learner after its step.

        Inference mode, in which benchmarks run, records no gradients, so it is left.
        """
        rate = self.config.learning_rate
        with torch.inference_mode(False), torch.set_grad_enabled(rate > 0):
            inputs = [part.detach().clone() for part in (pilots, *last, surface.both, surface.mask)]
            weights = learner.weights.detach().clone().requires_grad_(rate > 0)
            pilots, image, old_pilots, fits, both, mask = inputs
            last = Screened(image, old_pilots, fits)
            output, halves = _filter(weights, pilots, last, both)
            if rate > 0:
                loss = self_supervised_loss(halves, pilots, old_pilots, mask)
                (gradient,) = torch.autograd.grad(loss.sum(), weights)
                learner = learner.step(gradient, rate)
        return (output * mask).clamp(0, MAX_LOG).detach(), learner


class Surface(NamedTuple):
    """Surfaces of a frame; 0 where there is none or where it reflects nothing."""

    mask: Bool[Tensor, "n 1 h w"]
    albedo: Float[Tensor, "n 3 h w"]
    normal: Float[Tensor, "n 3 h w"]
    depth: Float[Tensor, "n 1 h w"]

    @property
    def both(self) -> Float[Tensor, "n 6 h w"]:
        """Albedo and normal."""
        return torch.cat((self.albedo, self.normal), 1)


class _LogImage(NamedTuple):
    """What `contrast` reads."""

    image: Float[Tensor, "n 3 h w"]


def _read_surface(gbuffer: GBuffer) -> Surface:
    mask = surface_mask(gbuffer.albedo, gbuffer.depth)
    parts = (gbuffer.albedo, gbuffer.normal, gbuffer.depth)
    return Surface(mask, *(part.where(mask, 0.0) for part in parts))


def make_pilots(samples: Samples, surface: Surface) -> Float[Tensor, "n 6 h w"]:
    """Pilots A and B, log(1 + radiance): B's samples as A explains them, and the reverse."""
    first, second = (half.log1p().where(surface.mask, 0.0) for half in split_halves(samples))
    pairs = ((first, second), (second, first))
    return torch.cat([regress(*pair, surface.albedo, surface.normal) for pair in pairs], 1)


def _reproject(
    gbuffer: GBuffer, surface: Surface, state: State
) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 6 h w"], Bool[Tensor, "n 1 h w"]]:
    """Last output and pilots as seen from this frame, and where all of 3 x 3 pixels have them."""
    before, now = (state.depth, state.normal), (surface.depth, surface.normal)
    taps = find_surface_taps(gbuffer.motion, now, before, MIN_NORMAL_COSINE)
    old = repair_history(torch.cat((state.image, state.pilots), 1), 0.0, MAX_LOG)
    image, pilots = taps.gather(old).split_with_sizes((3, 6), 1)
    missing = F.max_pool2d((~taps.valid).float(), 3, stride=1, padding=1)
    return image, pilots, missing == 0


def screen(
    pilots: Float[Tensor, "n 6 h w"],
    image: Float[Tensor, "n 3 h w"],
    old_pilots: Float[Tensor, "n 6 h w"],
    known: Bool[Tensor, "n 1 h w"],
) -> Screened:
    """Each of last output and pilots, or the current one where it leaves the window's range.

    The range is that of the mean of the pilots, or of the pilot, in 7 x 7 pixels; all channels have
    to be inside.
    """
    current = torch.cat((torch.unflatten(pilots, 1, (2, 3)).mean(1), pilots), 1)
    previous = torch.cat((image, old_pilots), 1)
    both = torch.cat((current, -current), 1)
    for side in ((1, SCREEN_SIDE), (SCREEN_SIDE, 1)):  # rows, then columns
        both = F.max_pool2d(both, side, stride=1, padding=(side[0] // 2, side[1] // 2))
    most, negative_least = both.chunk(2, 1)
    inside = (previous < most) & (-previous < negative_least)
    fits = torch.unflatten(inside, 1, (3, 3)).all(2) & known
    chosen = previous.where(fits.repeat_interleave(3, 1), current)
    return Screened(chosen[:, :3], chosen[:, 3:], fits[:, :1])


def _restart(
    learner: Learner, initial: Float[Tensor, " p"], known: Bool[Tensor, "n 1 h w"]
) -> Learner:
    """The learners; those of clips without history, or with broken numbers, begin anew."""
    goes_on = known.flatten(1).any(1, keepdim=True)
    for part in learner:
        goes_on = goes_on & part.isfinite().all(1, keepdim=True)
    is_valid = (learner.square >= 0) & (learner.weights.abs() <= MAX_WEIGHT)
    goes_on = goes_on & is_valid.all(1, keepdim=True)
    new = Learner.begin(initial, len(learner.weights))
    return Learner(*(torch.where(goes_on, a, b) for a, b in zip(learner, new, strict=True)))


def _filter(
    weights: Float[Tensor, "n p"],
    pilots: Float[Tensor, "n 6 h w"],
    last: Screened,
    surface: Float[Tensor, "n 6 h w"],
) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 6 h w"]]:
    """The output, and that of each half, all mixed with the last output by alpha."""
    bands, alpha = predict(weights, torch.cat((pilots, last.image, surface), 1))
    alpha = torch.where(last.fits, alpha, 1.0)
    sums = filter_pilots(pilots, surface, bands)  # n 2 4 h w
    colour, weight = sums[:, :, :3], sums[:, :, 3:]
    both = colour.sum(1) / (weight.sum(1) + WEIGHT_OFFSET)
    halves = (colour / (weight + WEIGHT_OFFSET)).flatten(1, 2)
    output = torch.lerp(last.image, both, alpha)
    return output, torch.lerp(last.image.repeat(1, 2, 1, 1), halves, alpha)


def self_supervised_loss(
    halves: Float[Tensor, "n 6 h w"],
    pilots: Float[Tensor, "n 6 h w"],
    old_pilots: Float[Tensor, "n 6 h w"],
    surface: Bool[Tensor, "n 1 h w"],
) -> Float[Tensor, " n"]:
    """Relative squared error of each half against the other's pilot and its own of the last frame.

    Channels and pixels are averaged; those without a surface count as 0.
    """
    labels = torch.cat((pilots[:, 3:], pilots[:, :3]), 1)
    errors = [
        (halves - each).square() / (each.square() + LOSS_OFFSET) for each in (labels, old_pilots)
    ]
    return ((errors[0] + errors[1]) / 2 * surface).mean((1, 2, 3))


@dataclass(frozen=True)
class Pilots:
    """The mean of both pilots of `cross`: cross-regression without network and without history."""

    traits: Traits

    def start(self, size: Size) -> None:
        """No state: frames are independent."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The image in linear radiance: the mean of both in radiance."""
        with torch.autocast(gbuffer.depth.device.type, enabled=False):
            surface = _read_surface(gbuffer)
            light = torch.unflatten(make_pilots(samples, surface).expm1(), 1, (2, 3)).mean(1)
            return light.where(surface.mask, sanitize_radiance(samples.mean)), None


@lru_cache(maxsize=1)
def learn_elsewhere() -> Float[Tensor, " p"]:
    """Weights after a pass of `cross` over a procedural clip of 32 frames at 2 spp: seconds."""
    clip = procedural_clip(0, Size(1, PASS_SIDE, PASS_SIDE), PASS_FRAMES)
    *_, last = run_clip(Cross(random_weights(BASE.seed)), clip, PASS_SPP)
    weights: Tensor = last.state.learner.weights[0]
    return weights


def build(variant: str, device: torch.device, weights: str | None) -> Cross | Pilots:
    """Online cross-regression; its weights are random, or those of a pass over another clip."""
    config, traits = VARIANTS[variant], FAMILY.variants[variant].traits
    if variant == "pilots":
        return Pilots(traits)
    initial = learn_elsewhere() if config.starts_learned else random_weights(config.seed)
    return Cross(initial.to(device), config, traits)
