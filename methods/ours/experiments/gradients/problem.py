"""The problem whose gradient is known: one toy frame, and a density with a few parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from methods.ours.experiments.gradients.systematic import SystematicProblem
from methods.ours.experiments.known_optimum import Direct, Filter, FixedFilter, Mode, ToyProblem
from methods.ours.experiments.toy_scenes import ToyFrame, toy_frames

__all__ = ["BUDGETS", "DENOISERS", "SIDE", "TILE", "TileAction", "make_problem", "tile_parameters"]

SIDE = 24  # rows and columns of the image
TILE = 6  # rows and columns of a tile: the density has one parameter per tile, 16 in total
BUDGETS = (0.0625, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 64.0)  # samples per pixel
ACTION_RANGE = 0.3  # of the action at which gradients are taken; the density varies by 0.7 to 1.3
MIN_STORED = 8  # samples per pixel, for low budgets
SCENE_SEED = 11

DENOISERS: Mapping[str, Mode] = {
    "no filter": Direct(),
    "fixed filter": FixedFilter(),
    "count-weighted filter": Filter(),
}


class TileAction(nn.Module):
    """An action that differs from pixel to pixel, plus one parameter per tile, at first zero.

    Each of n images has parameters of its own, so that one backward pass gives n gradients.
    """

    def __init__(self, n: int) -> None:
        """For n images."""
        super().__init__()
        self.parameters_per_tile = nn.Parameter(torch.zeros(n, 1, SIDE // TILE, SIDE // TILE))

    def forward(self, observation: Tensor) -> Float[Tensor, "n 1 h w"]:
        """The action; the observation has no effect on it."""
        offsets = self.parameters_per_tile.repeat_interleave(TILE, 2).repeat_interleave(TILE, 3)
        return _base_action() + offsets


def make_problem(denoiser: Mode, spp: float, n: int, generator: torch.Generator) -> ToyProblem:
    """The same scene n times, each with samples, prior and rounding of its own.

    Samples are log-normal around a known truth with a known deviation, and a pixel is estimated by
    the mean of its samples and a prior that weighs half a sample.
    """
    scene = _scene()
    repeated = {
        name: getattr(scene, name).expand(n, -1, -1, -1)
        for name in ("observation", "truth", "sigma", "prior")
    }
    stored = max(MIN_STORED, round(2 * spp) + MIN_STORED)  # more than any action asks for
    frame = replace(scene, **repeated).resample(generator, stored)
    return SystematicProblem(frame, denoiser, TileAction(n), spp)


def tile_parameters(problem: ToyProblem) -> Float[Tensor, "n 1 _ _"]:
    """The parameters of the density of each image, which gradients belong to."""
    assert isinstance(problem.sampler, TileAction)
    return problem.sampler.parameters_per_tile


@lru_cache
def _scene() -> ToyFrame:
    return next(toy_frames(SCENE_SEED, 1, SIDE))


@lru_cache
def _base_action() -> Tensor:
    """[1 1 h w] Fixed values in [-ACTION_RANGE, ACTION_RANGE] with mean zero, half of them smooth.

    A mean of zero leaves no gradient to the learners' penalty on the mean action.
    """
    generator = torch.Generator().manual_seed(SCENE_SEED)
    smooth = F.interpolate(torch.rand(1, 1, 4, 4, generator=generator), SIDE, mode="bilinear")
    action = smooth + torch.rand(1, 1, SIDE, SIDE, generator=generator)
    action = action - action.mean()
    return action * (ACTION_RANGE / action.abs().max())
