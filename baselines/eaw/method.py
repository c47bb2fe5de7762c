"""One frame through EAW: divide texture out, five passes of a wavelet, multiply it back."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.eaw import FAMILY
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.demodulation import reflectance, sanitize_radiance, surface_mask
from rlbench.ops.padded_rows import PaddedRows
from rlbench.ops.stencils import atrous_taps

FAR = 1e4  # stands for the logarithm of a depth that is none: weights to it are exactly 0
LOG2E = 1 / math.log(2)  # exp(x) is 2^(LOG2E x)


@dataclass(frozen=True)
class Config:
    """How fast weights fall: each is the squared distance at which a weight is 1/e."""

    passes: int = 5  # >= 1
    light: float = 16.0  # of log(1 + irradiance); half as much in each further pass
    normal: float = 0.1  # of unit normals, over the squared step in pixels
    depth: float = 1e-3  # of the logarithm of depth


@dataclass(frozen=True)
class Eaw:
    """The edge-avoiding a-trous wavelet transform (Dammertz et al. 2010), used as a blur.

    Pass i averages 5 x 5 pixels that lie 2^i apart, by a B3 spline times w_rt * w_n * w_x: falling
    exponentials of squared distances in colour, normal and position.

    That the width in colour halves from pass to pass is not verified. Ours: no view holds
    positions, so w_x compares logarithms of depth, which know no unit; colours are compared as
    log(1 + c), so that it is not the bright light alone that stops the filter; what is filtered is
    radiance over albedo (the mean of 3x3 pixels), so that texture is not blurred; background, and
    what emits without reflecting, passes through; the widths are the best of a grid on training
    clips (`python -m baselines.eaw.search`). A pixel whose mean is not finite is black before it is
    filtered.
    """

    config: Config = Config()
    traits: Traits = FAMILY.variants[""].traits

    def start(self, size: Size) -> None:
        """Nothing is remembered."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The filtered image, in linear radiance."""
        noisy, shade = sanitize_radiance(samples.mean), reflectance(gbuffer.albedo)
        solid = surface_mask(gbuffer.albedo, gbuffer.depth)
        n, _, h, w = noisy.shape
        flat = PaddedRows(n, h, w, margin=2**self.config.passes)
        light = flat.pack((noisy / shade).where(solid, 0.0))
        normal = flat.pack(gbuffer.normal)
        depth = flat.pack(gbuffer.depth.log().where(solid, FAR), fill=FAR)
        for index in range(self.config.passes):
            guide = self._guide(index, light, normal, depth)
            light = smooth(flat, 2**index, guide, light)
        return (flat.unpack(light) * shade).where(solid, noisy), None

    def _guide(
        self, index: int, light: Tensor, normal: Tensor, depth: Tensor
    ) -> Float[Tensor, "7 row"]:
        """Colour, normal and depth, such that the weight is 2 to minus the squared distance."""
        of_light = (LOG2E * 2**index / self.config.light) ** 0.5
        of_normal = (LOG2E / self.config.normal) ** 0.5 / 2**index
        of_depth = (LOG2E / self.config.depth) ** 0.5
        return torch.cat((light.log1p() * of_light, normal * of_normal, depth * of_depth))


def smooth(
    flat: PaddedRows, step: int, guide: Float[Tensor, "g row"], light: Float[Tensor, "c row"]
) -> Float[Tensor, "c row"]:
    """One pass: the mean of 5 x 5 pixels, weighted by a spline and 2^-|guide_p - guide_q|^2.

    A weight is the same both ways, so each is computed once and serves two pixels.
    """
    total, weights = light.clone(), torch.ones_like(light[:1])
    for start, stop in flat.chunks(light):
        apart = torch.empty(len(guide), stop - start, device=light.device)
        weight = apart[:1].clone()
        for tap in atrous_taps(step):
            away = flat.offset(tap.down, tap.right)
            here, there = slice(start, stop), slice(start + away, stop + away)
            torch.sub(guide[:, here], guide[:, there], out=apart).square_()
            torch.sum(apart, 0, keepdim=True, out=weight).neg_().exp2_().mul_(tap.weight)
            for to, source in ((here, there), (there, here)):
                total[:, to].addcmul_(light[:, source], weight)
                weights[:, to].add_(weight)
    return total / weights


def build(variant: str, device: torch.device, weights: str | None) -> Eaw:
    """EAW; nothing is learned."""
    return Eaw()
