"""EAW on still pixels: they keep their samples, and blocks of them take turns at being sampled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from baselines.eaw import STILL
from baselines.eaw.filter import Config, filter_irradiance
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.accumulation import surface_features
from rlbench.ops.box_filter import block_mean, box_mean
from rlbench.ops.demodulation import reflectance, surface_mask
from rlbench.ops.padding import crop, pad
from rlbench.ops.sanitize import repair_history, sanitize_radiance
from rlbench.ops.transfer import HALF_MAX

__all__ = ["Still", "StillPixels"]

STATIC_MOTION = 1e-3  # pixels; a smaller motion counts as none
HOLE_WINDOW = 5  # pixels; side of the window that holes are filled from
BLOCK_SIDE = 32  # pixels
TURN_SHARE = 1 / 16  # of the blocks that are sampled in one frame
TURN_SPP = 2.0  # samples that a block gets in one turn, roughly; fewer do not count
MAX_SPP = 64.0  # samples that old light weighs at most, so that changed light replaces it
TRUSTED_SPP = 16.0  # samples at which a pixel's own mean weighs as much as the filtered image
NO_FEATURE = 2.0  # as a surface's feature: equal to that of no surface
MAX_COUNT = 1e9  # of accumulated samples; a larger number is no count


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
