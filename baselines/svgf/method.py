"""One frame through SVGF: divide texture out, average over time, filter, multiply it back."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from baselines.svgf import FAMILY
from baselines.svgf.history import (
    History,
    TemporalMoments,
    accumulate,
    luminance,
    nothing,
    reproject_history,
)
from baselines.svgf.wavelet import Edges, atrous_pass
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.demodulation import reflectance, sanitize_radiance, surface_mask
from rlbench.ops.padded_rows import PaddedRows
from rlbench.ops.stencils import atrous_taps, box_taps

MIN_HISTORY_LENGTH = 4.0  # frames; the variance of a shorter history is estimated in space
REACH = 3  # pixels, of that estimate
FLATTEST = 1e-4  # least change of depth from pixel to pixel, as a share of depth
TINY = 1e-10  # added to variance before the root (Falcor)
LOG2E = 1 / math.log(2)  # exp(x) is 2^(LOG2E x)


@dataclass(frozen=True)
class Config:
    """What tells the variants apart."""

    keep_light: float = 0.2  # least weight of a new frame in the mean of colour, in (0, 1]
    keep_moments: float = 0.2  # the same for the moments of luminance
    passes: int = 5  # of the wavelet, >= 1
    feedback: int = 0  # the pass, from 0, whose output is remembered; below `passes`
    sigma_light: float = 4.0  # by how many standard deviations luminance may differ
    sigma_depth: float = 1.0  # by how many of its gradients depth may differ


BASE = Config()
VARIANTS = {
    "": BASE,
    # what does a longer memory give, with the constants of Falcor?
    "falcor": replace(BASE, keep_light=0.05, passes=4, feedback=1, sigma_light=10.0),
}


@dataclass(frozen=True)
class Svgf:
    """Spatiotemporal variance-guided filtering (Schied et al. 2017).

    The mean of the samples is divided by albedo; an exponential mean over time follows each surface
    and carries the first two moments of luminance; where it is young, variance is estimated over
    7 x 7 pixels instead, times 4 / length. Then come five passes of an edge-avoiding wavelet with
    the variance as the measure for luminance, filtered along; the output of the first is what the
    next frame remembers as colour. Background, and what emits without reflecting, passes through.

    Taken from public implementations, not from the paper: the three sigmas, the 7 x 7 window and
    its weights, the gradient of depth times distance, limits of lengths and weights (Falcor's SVGF
    pass); that a new frame weighs 0.2 or more is not verified. Differs from the paper: direct and
    indirect light are one layer; no mesh ids are compared; tone mapping and temporal antialiasing
    are left to others. No view holds emission: what emits and also reflects is filtered as if it
    were lit, and a lamp of low albedo spreads over what it lies on, more from frame to frame.

    Ours: taps of the history agree at 10 % of depth and a cosine of 0.9, and its length is averaged
    like the rest; the gradient of depth is, for each axis, the lesser of two one-sided differences,
    so that silhouettes have none, and at least 1e-4 of depth, so that rounding does not stop the
    filter on what faces the camera; albedo is the mean of 3x3 pixels, for light is of a whole pixel
    and a view of its centre, and is multiplied back as it was divided, 0.001 or more. A pixel whose
    mean is not finite keeps its history, or is black.
    """

    config: Config = BASE
    traits: Traits = FAMILY.variants[""].traits
    device: torch.device = torch.device("cpu")

    def start(self, size: Size) -> History:
        """Nothing is remembered."""
        return nothing(self._flat(size), self.device)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: History) -> Float[Tensor, "n 1 h w"]:
        """Uniform."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: History
    ) -> tuple[Float[Tensor, "n 3 h w"], History]:
        """The filtered image, and the memory with this frame in it."""
        noisy, shade = samples.mean, reflectance(gbuffer.albedo)
        solid = surface_mask(gbuffer.albedo, gbuffer.depth)
        light = torch.where(solid, sanitize_radiance(noisy) / shade, 0.0)
        depth = torch.where(solid, gbuffer.depth, 0.0)
        normal = torch.where(solid, unit(gbuffer.normal), 0.0)
        flat = self._flat(Size(len(noisy), *noisy.shape[2:]))

        recalled = reproject_history(flat, state, gbuffer.motion, depth, normal)
        keep = (self.config.keep_light, self.config.keep_moments)
        mean = accumulate(light, noisy.isfinite().all(1, keepdim=True), recalled, keep)

        slope = torch.where(solid, gradient(depth, solid), 1.0)
        decay = -LOG2E / (self.config.sigma_depth * slope)
        edges = Edges(*(flat.pack(each) for each in (normal, depth, decay)))
        start = _estimated(flat, edges, mean, solid, self.config.sigma_light)
        filtered, remembered = wavelet(flat, edges, *start, self.config)
        image = torch.where(solid, flat.unpack(filtered) * shade, sanitize_radiance(noisy))

        rest = torch.cat((mean.moments, mean.length.where(solid, 0.0)), 1)
        return image, History(torch.cat((remembered, flat.pack(rest))), edges.depth, edges.normal)

    def _flat(self, size: Size) -> PaddedRows:
        """A margin for the widest pass."""
        return PaddedRows(*size, margin=max(REACH, 2**self.config.passes))


def wavelet(
    flat: PaddedRows,
    edges: Edges,
    light: Float[Tensor, "3 row"],
    variance: Float[Tensor, "1 row"],
    config: Config,
) -> tuple[Float[Tensor, "3 row"], Float[Tensor, "3 row"]]:
    """Irradiance after the last pass, and after the one that is remembered."""
    remembered = light
    for index in range(config.passes):
        keen = (_blurred(flat, variance) + TINY).rsqrt() * (-LOG2E / config.sigma_light)
        bright = luminance(light[None])[0]
        sums = atrous_pass(flat, atrous_taps(2**index), edges, (bright, keen), light, variance)
        light, variance = sums.values / sums.weight, sums.variance / sums.weight.square()
        if index == config.feedback:
            remembered = light
    return light, remembered


def gradient(
    depth: Float[Tensor, "n 1 h w"], solid: Bool[Tensor, "n 1 h w"]
) -> Float[Tensor, "n 1 h w"]:
    """How much depth changes from pixel to pixel, right plus down, within one surface."""
    total = torch.zeros_like(depth)
    height = depth.where(solid, torch.inf)
    for before, after, axis in (((1, 0, 0, 0), (0, 1, 0, 0), 3), ((0, 0, 1, 0), (0, 0, 0, 1), 2)):
        step = height.diff(dim=axis).abs()
        sides = (F.pad(step, pad, value=torch.inf) for pad in (before, after))
        total = total + torch.minimum(*sides).nan_to_num(0, posinf=0)
    return torch.maximum(total, FLATTEST * depth)


def unit(normal: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """The same directions, of length 1: stored in half floats they are not quite; zero stays."""
    x, y, z = normal.unbind(1)
    return normal * (x * x + y * y + z * z).clamp_min(1e-12).rsqrt()[:, None]


def _estimated(
    flat: PaddedRows,
    edges: Edges,
    mean: TemporalMoments,
    solid: Bool[Tensor, "n 1 h w"],
    sigma: float,
) -> tuple[Float[Tensor, "3 row"], Float[Tensor, "1 row"]]:
    """Irradiance and its variance; where history is short, both come from the neighbourhood."""
    light, variance = flat.pack(mean.light), flat.pack(mean.variance)
    short = solid & (mean.length < MIN_HISTORY_LENGTH)
    if not short.any():
        return light, variance
    bright = luminance(light[None])[0]
    values = torch.cat((light, flat.pack(mean.moments)))
    keen = torch.full_like(bright, -LOG2E / sigma)
    sums = atrous_pass(flat, box_taps(REACH), edges, (bright, keen), values, variance)
    mean_near = sums.values / sums.weight
    first, second = mean_near[3:4], mean_near[4:]
    boost = flat.pack(MIN_HISTORY_LENGTH / mean.length)
    wide = (second - first.square()).clamp_min(0) * boost
    young = flat.pack(short.float()) > 0
    return torch.where(young, mean_near[:3], light), torch.where(young, wide, variance)


def _blurred(flat: PaddedRows, variance: Float[Tensor, "1 row"]) -> Float[Tensor, "1 row"]:
    """Variance after a 3 x 3 Gaussian; beyond borders and surfaces it is zero, as in Falcor."""
    for step in (1, flat.pitch):
        blurred = 0.5 * variance
        blurred[:, step:] += 0.25 * variance[:, :-step]
        blurred[:, :-step] += 0.25 * variance[:, step:]
        variance = blurred
    return variance


def build(variant: str, device: torch.device, weights: str | None) -> Svgf:
    """SVGF; nothing is learned."""
    return Svgf(VARIANTS[variant], FAMILY.variants[variant].traits, device)
