"""EAW: an edge-avoiding a-trous filter, on single frames or on light that still pixels keep."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from baselines.eaw import STILL, TRAITS
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.accumulation import surface_features
from rlbench.ops.asking import is_compiling
from rlbench.ops.box_filter import block_mean, box_mean
from rlbench.ops.demodulation import reflectance, surface_mask
from rlbench.ops.fireflies import mean_without_fireflies
from rlbench.ops.padded_rows import PaddedRows, read_windows
from rlbench.ops.padding import crop, pad
from rlbench.ops.sanitize import repair_history, sanitize_radiance
from rlbench.ops.stencils import Stencil, atrous_stencil
from rlbench.ops.transfer import HALF_MAX

NO_SURFACE = 1e4  # log depth of pixels without a surface: weights to them are exactly 0
ALIGNMENT = 64  # elements: torch sums and exponentiates the last few of others in another way
LOG2E = 1 / math.log(2)  # exp(x) = 2^(LOG2E x)

STATIC_MOTION = 1e-3  # pixels; a smaller motion counts as none
HOLE_WINDOW = 5  # pixels; side of the window that holes are filled from
BLOCK_SIDE = 32  # pixels
TURN_SHARE = 1 / 16  # of the blocks that are sampled in one frame
TURN_SPP = 2.0  # samples that a block gets in one turn, roughly; fewer do not count
MAX_SPP = 64.0  # samples that old light weighs at most, so that changed light replaces it
TRUSTED_SPP = 16.0  # samples at which a pixel's own mean weighs as much as the filtered image
NO_FEATURE = 2.0  # as a surface's feature: equal to that of no surface
MAX_COUNT = 1e9  # of accumulated samples; a larger number is no count


@dataclass(frozen=True)
class Config:
    """Filter widths: the squared distance at which an edge-stopping weight is 1/e."""

    passes: int = 5  # >= 1
    phi_color: float = 16.0  # of log(1 + irradiance) in the first pass; halved in each further pass
    phi_normal: float = 0.1  # of unit normals, divided by the squared step in pixels
    phi_depth: float = 1e-3  # of log depth


def filter_irradiance(
    config: Config,
    irradiance: Float[Tensor, "n 3 h w"],
    surface: Bool[Tensor, "n 1 h w"],
    gbuffer: GBuffer,
) -> Float[Tensor, "n 3 h w"]:
    """Irradiance after all a-trous passes; pixels that are no surface have no part in it."""
    n, _, h, w = irradiance.shape
    rows = PaddedRows(n, h, w, margin=2**config.passes)
    row = rows.pack(irradiance.where(surface, 0.0))
    normal = rows.pack(gbuffer.normal)
    log_depth = rows.pack(gbuffer.depth.log().where(surface, NO_SURFACE), fill=NO_SURFACE)
    for index in range(config.passes):
        features = _scale_features(config, index, row, normal, log_depth)
        row = atrous_pass(rows, 2**index, features, row)
    return rows.unpack(row)


def _scale_features(
    config: Config, index: int, irradiance: Tensor, normal: Tensor, log_depth: Tensor
) -> Float[Tensor, "7 row"]:
    """Colour, normal and depth, scaled so that a weight is 2^-(squared distance)."""
    color_scale = (LOG2E * 2**index / config.phi_color) ** 0.5
    normal_scale = (LOG2E / config.phi_normal) ** 0.5 / 2**index
    depth_scale = (LOG2E / config.phi_depth) ** 0.5
    return torch.cat(
        (irradiance.log1p() * color_scale, normal * normal_scale, log_depth * depth_scale)
    )


class Decay:
    """2^-|f_p - f_q|^2 of features f, for the same number of pixels in every call."""

    def __init__(self, features: Float[Tensor, "g row"], length: int) -> None:
        """Buffers for `length` pixels."""
        self.features, self.length = features, length
        self.difference = features.new_zeros(len(features), length + -length % ALIGNMENT)
        self.decay = self.difference[:1].clone()

    def __call__(self, p: slice, q: slice) -> Float[Tensor, "1 piece"]:
        """The weights, which the next call overwrites."""
        difference = self.difference
        torch.sub(self.features[:, p], self.features[:, q], out=difference[:, : self.length])
        torch.sum(difference.square_(), 0, keepdim=True, out=self.decay).neg_().exp2_()
        return self.decay[:, : self.length]


def atrous_pass(
    rows: PaddedRows,
    step: int,
    features: Float[Tensor, "g row"],
    irradiance: Float[Tensor, "c row"],
) -> Float[Tensor, "c row"]:
    """One a-trous pass: mean over 5 x 5 pixels, `step` pixels apart.

    The weight is a B3 spline times 2^-|f_p - f_q|^2 for features f. Weights are symmetric, so each
    is computed once and used for both pixels. Far neighbours come first, and those after a pixel
    are summed apart from those before it: so chunks of the row do not change the order of a sum,
    and a window of an image has the bits of the image.
    """
    stencil, values = atrous_stencil(step), torch.cat((irradiance, torch.ones_like(irradiance[:1])))
    if is_compiling():
        return _average_windows(rows, stencil, features, values)
    before, after = torch.zeros_like(values), values.clone()
    for start, stop in rows.chunks(irradiance):
        decay = Decay(features, stop - start)
        for tap in reversed(stencil.taps):
            shift = rows.offset(tap.down, tap.right)
            p, q = slice(start, stop), slice(start + shift, stop + shift)
            weight = decay(p, q).mul_(tap.weight)
            after[:, p].addcmul_(values[:, q], weight)
            before[:, q].addcmul_(values[:, p], weight)
    total = before.add_(after)
    return total[:-1] / total[-1:]


def _average_windows(
    rows: PaddedRows,
    stencil: Stencil,
    features: Float[Tensor, "g row"],
    values: Float[Tensor, "c row"],
) -> Float[Tensor, "c-1 row"]:
    """As `atrous_pass`, all taps of a pixel at once: what a compiler makes one loop of."""
    around = partial(read_windows, pitch=rows.pitch, reach=stencil.reach, step=stencil.step)
    others, neighbours = map(around, (features, values))
    distance = sum((own - other).square() for own, other in zip(features, others, strict=True))
    total = (neighbours * (stencil.squares(values)[0] * torch.exp2(-distance))).sum((1, 2))
    return total[:-1] / total[-1:]


@dataclass(frozen=True)
class Eaw:
    """Edge-avoiding a-trous wavelet transform (Dammertz et al. 2010), used as a filter.

    Pass i averages 5 x 5 pixels with a step of 2^i, weighted by a B3 spline times w_rt * w_n * w_x:
    exponentials of negative squared distances in colour, normal and position. Uniform sampling,
    frames are independent.

    Not verified: that the width in colour halves from pass to pass. Ours: G-buffers hold no
    positions, so w_x compares log depth, which is independent of the scene's unit; colours are
    compared as log(1 + c), so that bright light does not dominate the edges; the filtered signal is
    radiance over albedo (its mean over 3 x 3 pixels), so that textures are not blurred; background
    and emitters that reflect nothing pass through unfiltered; the widths are the best of a grid on
    training clips (`python -m baselines.eaw.search`). Fireflies are limited before filtering
    (rlbench.ops.limit_fireflies).
    """

    config: Config = Config()
    traits: Traits = TRAITS

    def start(self, size: Size) -> None:
        """No state: frames are independent."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The filtered image, linear radiance."""
        noisy, albedo = sanitize_radiance(samples.mean), reflectance(gbuffer.albedo)
        limited = mean_without_fireflies(samples.radiance, samples.counts)
        surface = surface_mask(gbuffer.albedo, gbuffer.depth)
        irradiance = filter_irradiance(self.config, limited / albedo, surface, gbuffer)
        return (irradiance * albedo).where(surface, noisy), None


class StillPixels(NamedTuple):
    """What is carried from one frame to the next, pixel by pixel."""

    radiance: Float[Tensor, "n 3 h w"]  # mean of the samples so far, linear
    spp: Float[Tensor, "n 1 h w"]  # number of these samples; 0 means no history
    surface: Float[Tensor, "n 7 h w"]  # `surface_features` of the last frame


@dataclass(frozen=True)
class Still:
    """The filter of `eaw` on light that still pixels accumulate, for cameras that stand still.

    Ours, a control for skipped tiles. A pixel is still if it has no motion and exactly the surface
    of the last frame; it then keeps its samples, and others begin anew. Half of the budget goes to
    pixels that are not still, the other half to one block in sixteen of those with the fewest
    samples, in reading order, so that most of the image gets none. What neither half can take goes
    to all pixels. Holes are filled from 5 x 5 pixels, three a-trous passes follow, and the more
    samples a pixel has, the more its own mean replaces the filtered image: half at 16.

    Every pixel depends on those up to 17 pixels away, and stays as it is without samples. Not in
    `eaw`'s favour: fireflies are not limited, because that limit depends on the whole image, and
    history is not reprojected. Light that changes on still pixels is late: old light weighs up to
    64 samples. No constant was tuned.
    """

    config: Config = Config(passes=3)
    traits: Traits = STILL
    device: torch.device = torch.device("cpu")

    def start(self, size: Size) -> StillPixels:
        """No history."""
        zeros = torch.zeros(size.n, 4, size.h, size.w, device=self.device)
        nowhere = torch.full((size.n, 7, size.h, size.w), NO_FEATURE, device=self.device)
        return StillPixels(zeros[:, :3], zeros[:, 3:], nowhere)

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: StillPixels
    ) -> Float[Tensor, "n 1 h w"]:
        """Equal shares for pixels that are not still, and for the blocks whose turn it is."""
        still = _find_still(gbuffer, state)
        moved, turn = ~still, _find_turns(still, _repair_spp(state)) & still
        shares = [mask / mask.sum((2, 3), keepdim=True).clamp_min(1) for mask in (moved, turn)]
        return shares[0] + shares[1]

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: StillPixels
    ) -> tuple[Float[Tensor, "n 3 h w"], StillPixels]:
        """The filtered image in linear radiance, and the samples so far."""
        known = _repair_spp(state).where(_find_still(gbuffer, state), 0.0)
        new = samples.counts.float()
        weight = known.clamp_max(MAX_SPP)
        share = weight / (weight + new).clamp_min(1)
        old = repair_history(state.radiance, 0.0, HALF_MAX)
        # slot by slot: torch's sums round the last pixels of a window in another way
        noisy = sum(samples.radiance.unbind(1)) / samples.counts.clamp_min(1)
        radiance = torch.lerp(sanitize_radiance(noisy), old, share)
        spp = known + new

        surface = surface_mask(gbuffer.albedo, gbuffer.depth)
        albedo = torch.where(surface, reflectance(gbuffer.albedo), 1.0)
        filled = _fill_holes(radiance / albedo, spp, surface)
        filtered = filter_irradiance(self.config, filled, surface, gbuffer)
        filtered = torch.where(surface, filtered, filled) * albedo
        image = torch.lerp(filtered, radiance, spp / (spp + TRUSTED_SPP))
        return image, StillPixels(radiance, spp, _features(gbuffer))


def _features(gbuffer: GBuffer) -> Float[Tensor, "n 7 h w"]:
    return surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)


def _find_still(gbuffer: GBuffer, state: StillPixels) -> Bool[Tensor, "n 1 h w"]:
    """True where exactly the surface of the last frame is, without motion."""
    still = (state.surface == _features(gbuffer)).all(1, keepdim=True)
    if gbuffer.motion is None:
        return still
    return still & (gbuffer.motion.abs().amax(1, keepdim=True) < STATIC_MOTION)


def _repair_spp(state: StillPixels) -> Float[Tensor, "n 1 h w"]:
    return repair_history(state.spp, 0.0, MAX_COUNT)


def _find_turns(
    still: Bool[Tensor, "n 1 h w"], spp: Float[Tensor, "n 1 h w"]
) -> Bool[Tensor, "n 1 h w"]:
    """True in the blocks with the fewest samples per still pixel; in reading order if equal."""
    h, w = spp.shape[-2:]
    known = pad(torch.cat((spp * still, still.float()), 1), BLOCK_SIDE)
    total, count = block_mean(known, BLOCK_SIDE).chunk(2, dim=1)
    turns = torch.where(count > 0, total / count.clamp_min(1e-6) / TURN_SPP, torch.inf).floor()
    first = turns.flatten(1).argsort(dim=1, stable=True)
    chosen = torch.zeros_like(turns, dtype=torch.bool).flatten(1)
    chosen.scatter_(1, first[:, : max(1, round(first.shape[1] * TURN_SHARE))], value=True)
    blocks = chosen.view_as(turns).repeat_interleave(BLOCK_SIDE, 2)
    return crop(blocks.repeat_interleave(BLOCK_SIDE, 3), h, w)


def _fill_holes(
    values: Float[Tensor, "n 3 h w"],
    spp: Float[Tensor, "n 1 h w"],
    surface: Bool[Tensor, "n 1 h w"],
) -> Float[Tensor, "n 3 h w"]:
    """The values; where there are no samples, the mean of those in 5 x 5 pixels, or 0.

    Surfaces are filled from surfaces, and pixels without one from others without.
    """
    filled = values
    for kind in (surface, ~surface):
        weight = spp.where(kind, 0.0)
        sums = box_mean(torch.cat((values * weight, weight), 1), HOLE_WINDOW, "constant")
        mean = sums[:, :3] / sums[:, 3:].clamp_min(1e-6)
        filled = torch.where(kind & (spp == 0), mean, filled)
    return filled


def build(variant: str, device: torch.device, weights: str | None) -> Eaw | Still:
    """EAW with the default widths, on frames or on still pixels; it has no weights."""
    return Still(device=device) if variant == "still" else Eaw()
