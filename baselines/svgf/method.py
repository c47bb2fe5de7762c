"""One frame of SVGF: demodulate, reproject, accumulate, estimate variance, a-trous, modulate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from baselines.svgf import FAMILY
from baselines.svgf.history import (
    History,
    TemporalMoments,
    accumulate,
    empty_history,
    luminance,
    reproject_history,
)
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.asking import is_compiling, may_ask
from rlbench.ops.demodulation import reflectance, surface_mask
from rlbench.ops.fireflies import mean_without_fireflies
from rlbench.ops.padded_rows import PaddedRows, read_windows
from rlbench.ops.sanitize import sanitize_radiance
from rlbench.ops.stencils import Stencil, Tap, atrous_stencil, box_stencil

MIN_HISTORY_LENGTH = 4.0  # frames; the variance of a shorter history is estimated spatially
VARIANCE_RADIUS = 3  # of the window of that estimate, pixels
MIN_RELATIVE_GRADIENT = 1e-4  # lower bound of the depth gradient, per pixel, times depth
VARIANCE_EPS = 1e-10  # added to variance before the root (Falcor)
LOG2E = 1 / math.log(2)  # exp(x) = 2^(LOG2E x)
SQUARINGS = 7  # the exponent of the cosine between normals is 128 = 2^7


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants."""

    alpha_color: float = 0.2  # least weight of a new frame in colour, in (0, 1]
    alpha_moments: float = 0.2  # least weight of a new frame in the moments of luminance, in (0, 1]
    passes: int = 5  # a-trous passes, >= 1
    feedback_tap: int = 0  # index of the pass whose output becomes the history; below `passes`
    sigma_luminance: float = 4.0  # tolerance of luminance, in standard deviations
    sigma_depth: float = 1.0  # tolerance of depth, in depth gradients


BASE = Config()
VARIANTS = {
    "": BASE,
    # what does a longer history give, with Falcor's constants?
    "falcor": replace(BASE, alpha_color=0.05, passes=4, feedback_tap=1, sigma_luminance=10.0),
}


@dataclass(frozen=True)
class Svgf:
    """Spatiotemporal variance-guided filtering (Schied et al. 2017).

    The mean of the samples is divided by albedo. Colour and the first two moments of luminance are
    accumulated over time along the motion vectors. Where the history is short, variance is
    estimated over 7 x 7 pixels instead, times 4 / length. Five passes of an edge-avoiding a-trous
    filter follow, whose luminance weights use the variance, which is filtered along. The output of
    the first pass becomes the colour history. Background, and emitters that reflect nothing, pass
    through. Uniform sampling.

    From public implementations, not from the paper: the three sigmas; the 7 x 7 window and its
    weights; depth gradient times distance; limits of lengths and weights (Falcor's SVGF pass). Not
    verified: that a new frame weighs at least 0.2. Differs from the paper: direct and indirect
    light are one layer; mesh ids are not compared; there is no tone mapping and no temporal
    antialiasing. G-buffers hold no emission: a surface that emits and reflects is filtered as if it
    were lit, and an emitter of low albedo bleeds into its surroundings, more from frame to frame.

    Ours: history taps match within 10 % of depth and a cosine of 0.9, and history length is
    interpolated like the rest; the depth gradient is, for each axis, the lesser of two one-sided
    differences, so that silhouettes have none, and at least 1e-4 of depth, so that rounding does
    not stop the filter on surfaces that face the camera; albedo is the mean of 3 x 3 pixels, since
    radiance covers a pixel and the G-buffer samples its centre, and modulation uses the same
    albedo, at least 0.001. Fireflies are limited on surfaces (rlbench.ops.limit_fireflies). A pixel
    whose mean is not finite keeps its history, or is black; history that is not finite is dropped.
    """

    config: Config = BASE
    traits: Traits = FAMILY.variants[""].traits
    device: torch.device = torch.device("cpu")

    def start(self, size: Size) -> History:
        """An empty history."""
        return empty_history(self._padded_rows(size), self.device)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: History) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: History
    ) -> tuple[Float[Tensor, "n 3 h w"], History]:
        """The filtered image in linear radiance, and the history for the next frame."""
        # demodulate
        noisy, albedo = samples.mean, reflectance(gbuffer.albedo)
        surface = surface_mask(gbuffer.albedo, gbuffer.depth)
        limited = mean_without_fireflies(samples.radiance, samples.counts)
        irradiance = torch.where(surface, limited / albedo, 0.0)
        depth = torch.where(surface, gbuffer.depth, 0.0)
        normal = torch.where(surface, normalize(gbuffer.normal), 0.0)
        rows = self._padded_rows(Size(len(noisy), *noisy.shape[2:]))

        # reproject and accumulate
        history = reproject_history(rows, state, gbuffer.motion, depth, normal)
        alphas = (self.config.alpha_color, self.config.alpha_moments)
        finite = noisy.isfinite().all(1, keepdim=True)
        moments = accumulate(irradiance, finite, history, alphas)

        # estimate variance
        depth_change = torch.where(surface, depth_gradient(depth, surface), 1.0)
        depth_decay = -LOG2E / (self.config.sigma_depth * depth_change)
        edges = Edges(*(rows.pack(image) for image in (normal, depth, depth_decay)))
        estimate = _estimate_variance(rows, edges, moments, surface, self.config.sigma_luminance)

        # a-trous
        filtered, feedback = atrous_filter(rows, edges, *estimate, self.config)

        # modulate
        image = torch.where(surface, rows.unpack(filtered) * albedo, sanitize_radiance(noisy))
        length = moments.length.where(surface, 0.0)
        rest = rows.pack(torch.cat((moments.moments, length), 1))
        return image, History(torch.cat((feedback, rest)), edges.depth, edges.normal)

    def _padded_rows(self, size: Size) -> PaddedRows:
        """Rows with a margin for the widest pass."""
        return PaddedRows(*size, margin=max(VARIANCE_RADIUS, 2**self.config.passes))


def atrous_filter(
    rows: PaddedRows,
    edges: Edges,
    irradiance: Float[Tensor, "3 row"],
    variance: Float[Tensor, "1 row"],
    config: Config,
) -> tuple[Float[Tensor, "3 row"], Float[Tensor, "3 row"]]:
    """Irradiance after the last a-trous pass, and after the feedback tap."""
    feedback = irradiance
    for index in range(config.passes):
        deviation_inverse = (_blur_3x3(rows, variance) + VARIANCE_EPS).rsqrt()
        guide = (
            luminance(irradiance[None])[0],
            deviation_inverse * (-LOG2E / config.sigma_luminance),
        )
        sums = atrous_pass(rows, atrous_stencil(2**index), edges, guide, irradiance, variance)
        irradiance, variance = sums.values / sums.weight, sums.variance / sums.weight.square()
        if index == config.feedback_tap:
            feedback = irradiance
    return irradiance, feedback


def depth_gradient(
    depth: Float[Tensor, "n 1 h w"], surface: Bool[Tensor, "n 1 h w"]
) -> Float[Tensor, "n 1 h w"]:
    """Change of depth per pixel, horizontal plus vertical, within one surface.

    >>> ramp = torch.arange(1.0, 5.0).expand(1, 1, 4, 4)
    >>> depth_gradient(ramp, ramp > 0)[0, 0, 0]
    tensor([1., 1., 1., 1.])
    """
    total = torch.zeros_like(depth)
    masked = depth.where(surface, torch.inf)
    for before, after, axis in (((1, 0, 0, 0), (0, 1, 0, 0), 3), ((0, 0, 1, 0), (0, 0, 0, 1), 2)):
        difference = masked.diff(dim=axis).abs()
        one_sided = (F.pad(difference, pad, value=torch.inf) for pad in (before, after))
        total = total + torch.minimum(*one_sided).nan_to_num(0, posinf=0)
    return torch.maximum(total, MIN_RELATIVE_GRADIENT * depth)


def normalize(normal: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Unit normals; zero stays zero. Half floats store normals that are not quite unit length."""
    x, y, z = normal.unbind(1)
    return normal * (x * x + y * y + z * z).clamp_min(1e-12).rsqrt()[:, None]


def _estimate_variance(
    rows: PaddedRows,
    edges: Edges,
    moments: TemporalMoments,
    surface: Bool[Tensor, "n 1 h w"],
    sigma_luminance: float,
) -> tuple[Float[Tensor, "3 row"], Float[Tensor, "1 row"]]:
    """Irradiance and its variance: temporal, or spatial where the history is short."""
    irradiance, variance = rows.pack(moments.irradiance), rows.pack(moments.variance)
    is_short = surface & (moments.length < MIN_HISTORY_LENGTH)
    if may_ask(is_short) and not is_short.any():
        return irradiance, variance
    pixel_luminance = luminance(irradiance[None])[0]
    guide = pixel_luminance, torch.full_like(pixel_luminance, -LOG2E / sigma_luminance)
    values = torch.cat((irradiance, rows.pack(moments.moments)))
    sums = atrous_pass(rows, box_stencil(VARIANCE_RADIUS), edges, guide, values, variance)
    mean = sums.values / sums.weight
    first_moment, second_moment = mean[3:4], mean[4:]
    boost = rows.pack(MIN_HISTORY_LENGTH / moments.length)
    spatial_variance = (second_moment - first_moment.square()).clamp_min(0) * boost
    short = rows.pack(is_short.float()) > 0
    return torch.where(short, mean[:3], irradiance), torch.where(short, spatial_variance, variance)


def _blur_3x3(rows: PaddedRows, variance: Float[Tensor, "1 row"]) -> Float[Tensor, "1 row"]:
    """Variance after a 3 x 3 Gaussian; beyond borders and surfaces it is zero, as in Falcor."""
    for step in (1, rows.pitch):
        blurred = 0.5 * variance
        blurred[:, step:] += 0.25 * variance[:, :-step]
        blurred[:, :-step] += 0.25 * variance[:, step:]
        variance = blurred
    return variance


@dataclass(frozen=True)
class Edges:
    """Features that stop the filter, in padded rows; luminance changes between passes."""

    normal: Float[Tensor, "3 row"]  # unit length; zero where there is no surface
    depth: Float[Tensor, "1 row"]  # finite everywhere
    depth_decay: Float[Tensor, "1 row"]  # log2 weight per difference of depth over pixels; <= 0


class Sums(NamedTuple):
    """Sums over a pixel and its neighbours, in padded rows."""

    values: Float[Tensor, "c row"]  # of weight * value
    variance: Float[Tensor, "1 row"]  # of weight^2 * variance
    weight: Float[Tensor, "1 row"]  # of weight, >= 1


def atrous_pass(
    rows: PaddedRows,
    stencil: Stencil,
    edges: Edges,
    luminance_guide: tuple[Float[Tensor, "1 row"], Float[Tensor, "1 row"]],
    values: Float[Tensor, "c row"],
    variance: Float[Tensor, "1 row"],
) -> Sums:
    """Sums over neighbours; the weight from q to p is kernel * w_z * w_n * w_l (Schied 2017, 4.4).

    w_z = 2^(depth_decay_p |z_p - z_q| / |p - q|), w_n = max(0, n_p n_q)^128 and
    w_l = 2^(decay_p |l_p - l_q|), where `luminance_guide` is (l, decay) with decay <= 0.
    Differences are symmetric and computed once for both directions. The weights are powers of 2
    because on a CPU torch's exp takes ten times as long where the result is nearly 0, as most
    weights are.
    """
    if is_compiling():
        return _sum_windows(rows, stencil, edges, luminance_guide, values, variance)
    sums = Sums(values.clone(), variance.clone(), torch.ones_like(variance))
    for start, stop in rows.chunks(variance):
        scratch = torch.empty(4, stop - start, device=values.device, dtype=values.dtype)
        for tap in stencil.taps:
            shift = rows.offset(tap.down, tap.right)
            p, q = slice(start, stop), slice(start + shift, stop + shift)
            _add_pair(p, q, tap, edges, luminance_guide, values, variance, sums, scratch)
    return sums


def _sum_windows(
    rows: PaddedRows,
    stencil: Stencil,
    edges: Edges,
    luminance_guide: tuple[Float[Tensor, "1 row"], Float[Tensor, "1 row"]],
    values: Float[Tensor, "c row"],
    variance: Float[Tensor, "1 row"],
) -> Sums:
    """As `atrous_pass`, all neighbours of a pixel at once: what a compiler makes one loop of."""
    around = partial(read_windows, pitch=rows.pitch, reach=stencil.reach, step=stencil.step)
    luminance, luminance_decay = luminance_guide
    kernel, distance = stencil.squares(values)
    w_n = sum(own * other for own, other in zip(edges.normal, around(edges.normal), strict=True))
    w_n = w_n.clamp_min(0)
    for _ in range(SQUARINGS):
        w_n = w_n * w_n
    log_weight = (luminance[0] - around(luminance)[0]).abs() * luminance_decay[0]
    depth_difference = (edges.depth[0] - around(edges.depth)[0]).abs()
    log_weight = log_weight + depth_difference * edges.depth_decay[0] / distance.clamp_min(1)
    weight = kernel * torch.where(distance > 0, log_weight.exp2() * w_n, 1.0)
    return Sums(
        (around(values) * weight).sum((1, 2)),
        (around(variance) * weight.square()).sum((1, 2)),
        weight.sum((0, 1))[None],
    )


def _add_pair(
    p: slice,
    q: slice,
    tap: Tap,
    edges: Edges,
    luminance_guide: tuple[Tensor, Tensor],
    values: Tensor,
    variance: Tensor,
    sums: Sums,
    scratch: Float[Tensor, "4 piece"],
) -> None:
    """Add q's contribution to the sums at p, and p's to those at q."""
    w_n, depth_difference, luminance_difference, weight = (scratch[i : i + 1] for i in range(4))
    normal, depth, (luminance, luminance_decay) = edges.normal, edges.depth, luminance_guide
    torch.mul(normal[:1, p], normal[:1, q], out=w_n)
    w_n.addcmul_(normal[1:2, p], normal[1:2, q])
    w_n.addcmul_(normal[2:, p], normal[2:, q]).clamp_min_(0)
    for _ in range(SQUARINGS):
        w_n.mul_(w_n)
    torch.sub(depth[:, p], depth[:, q], out=depth_difference).abs_()
    torch.sub(luminance[:, p], luminance[:, q], out=luminance_difference).abs_()
    inverse_distance = (tap.down**2 + tap.right**2) ** -0.5
    for target, source in ((p, q), (q, p)):
        torch.mul(luminance_difference, luminance_decay[:, target], out=weight)
        weight.addcmul_(depth_difference, edges.depth_decay[:, target], value=inverse_distance)
        weight.exp2_().mul_(w_n)
        sums.values[:, target].addcmul_(values[:, source], weight, value=tap.weight)
        sums.weight[:, target].add_(weight, alpha=tap.weight)
        weight.mul_(weight)
        sums.variance[:, target].addcmul_(variance[:, source], weight, value=tap.weight**2)


def build(variant: str, device: torch.device, weights: str | None) -> Svgf:
    """SVGF with the variant's constants; it has no weights."""
    return Svgf(VARIANTS[variant], FAMILY.variants[variant].traits, device)
