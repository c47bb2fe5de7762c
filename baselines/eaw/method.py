"""One frame through EAW: demodulate albedo, five a-trous passes, modulate albedo."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.eaw import FAMILY
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.demodulation import reflectance, surface_mask
from rlbench.ops.fireflies import mean_without_fireflies
from rlbench.ops.padded_rows import PaddedRows
from rlbench.ops.sanitize import sanitize_radiance
from rlbench.ops.stencils import atrous_taps

__all__ = ["Config", "Eaw", "build", "atrous_pass"]

NO_SURFACE = 1e4  # log depth of pixels without a surface: weights to them are exactly 0
LOG2E = 1 / math.log(2)  # exp(x) = 2^(LOG2E x)


@dataclass(frozen=True)
class Config:
    """Filter widths: the squared distance at which an edge-stopping weight is 1/e."""

    passes: int = 5  # >= 1
    phi_color: float = 16.0  # of log(1 + irradiance) in the first pass; halved in each further pass
    phi_normal: float = 0.1  # of unit normals, divided by the squared step in pixels
    phi_depth: float = 1e-3  # of log depth


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
    traits: Traits = FAMILY.variants[""].traits

    def start(self, size: Size) -> None:
        """No state: frames are independent."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The filtered image, linear radiance."""
        # demodulate
        noisy, albedo = sanitize_radiance(samples.mean), reflectance(gbuffer.albedo)
        limited = mean_without_fireflies(samples.radiance, samples.counts)
        surface = surface_mask(gbuffer.albedo, gbuffer.depth)
        n, _, h, w = noisy.shape
        rows = PaddedRows(n, h, w, margin=2**self.config.passes)
        irradiance = rows.pack((limited / albedo).where(surface, 0.0))

        # a-trous passes
        normal = rows.pack(gbuffer.normal)
        log_depth = rows.pack(gbuffer.depth.log().where(surface, NO_SURFACE), fill=NO_SURFACE)
        for index in range(self.config.passes):
            features = self._scale_features(index, irradiance, normal, log_depth)
            irradiance = atrous_pass(rows, 2**index, features, irradiance)

        # modulate
        return (rows.unpack(irradiance) * albedo).where(surface, noisy), None

    def _scale_features(
        self, index: int, irradiance: Tensor, normal: Tensor, log_depth: Tensor
    ) -> Float[Tensor, "7 row"]:
        """Colour, normal and depth, scaled so that a weight is 2^-(squared distance)."""
        color_scale = (LOG2E * 2**index / self.config.phi_color) ** 0.5
        normal_scale = (LOG2E / self.config.phi_normal) ** 0.5 / 2**index
        depth_scale = (LOG2E / self.config.phi_depth) ** 0.5
        return torch.cat(
            (irradiance.log1p() * color_scale, normal * normal_scale, log_depth * depth_scale)
        )


def atrous_pass(
    rows: PaddedRows,
    step: int,
    features: Float[Tensor, "g row"],
    irradiance: Float[Tensor, "c row"],
) -> Float[Tensor, "c row"]:
    """One a-trous pass: mean over 5 x 5 pixels, `step` pixels apart.

    The weight is a B3 spline times 2^-|f_p - f_q|^2 for features f. Weights are symmetric, so each
    is computed once and used for both pixels.
    """
    total, weights = irradiance.clone(), torch.ones_like(irradiance[:1])
    for start, stop in rows.chunks(irradiance):
        difference = torch.empty(len(features), stop - start, device=irradiance.device)
        weight = difference[:1].clone()
        for tap in atrous_taps(step):
            shift = rows.offset(tap.down, tap.right)
            p, q = slice(start, stop), slice(start + shift, stop + shift)
            torch.sub(features[:, p], features[:, q], out=difference).square_()
            torch.sum(difference, 0, keepdim=True, out=weight).neg_().exp2_().mul_(tap.weight)
            for target, source in ((p, q), (q, p)):
                total[:, target].addcmul_(irradiance[:, source], weight)
                weights[:, target].add_(weight)
    return total / weights


def build(variant: str, device: torch.device, weights: str | None) -> Eaw:
    """EAW with the default widths; it has no weights."""
    return Eaw()
