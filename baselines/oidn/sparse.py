"""Below one sample per pixel, for denoisers of single frames: filled holes, half resolution."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples
from rlbench.method import Method, State
from rlbench.ops.accumulation import (
    AccumulatedRadiance,
    feature_similarity,
    fill_holes,
    frame_radiance,
    surface_features,
)
from rlbench.ops.box_filter import block_mean
from rlbench.ops.demodulation import demodulation_albedo
from rlbench.ops.fireflies import limit_fireflies
from rlbench.ops.padding import pad
from rlbench.wrappers import MethodWrapper

NEAR, FAR = 0.75, 0.25  # bilinear weights of the two coarse pixels next to a fine one, each axis
EDGE_FALLOFF = 2.0  # of similarity, per difference of normal and albedo: light stops at edges
MIN_SIMILARITY = 1e-3  # added to all, so that a pixel unlike its neighbours gets their plain mean


@dataclass(frozen=True)
class FilledHoles(MethodWrapper[Method]):
    """A denoiser of single frames that sees light of the neighbourhood where no sample is.

    Denoisers trained from one sample per pixel on take a pixel without samples for a black one.
    """

    sparse_traits: Traits  # those of the denoiser, for budgets from 0 on

    @property
    def traits(self) -> Traits:
        """The denoiser's traits, from 0 spp on."""
        return self.sparse_traits

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The denoised image of the filled samples."""
        filled = fill_holes(_limited_radiance(samples), gbuffer.albedo)
        return self.method.denoise(gbuffer, _one_sample(filled.mean), state)


@dataclass(frozen=True)
class HalfResolution(FilledHoles):
    """A denoiser at half resolution, with joint bilateral upsampling (Kopf et al. 2007).

    Four pixels share their samples; light without albedo is upsampled, so textures stay sharp.
    """

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The upsampled image."""
        radiance = _limited_radiance(samples)
        spp = _pool(radiance.accumulated_spp)
        mean = _pool(radiance.mean * radiance.accumulated_spp) / spp.clamp_min(1e-6)
        coarse = GBuffer({name: _pool(b) for name, b in gbuffer.buffers.items()}, gbuffer.static)
        # the second moment is not read
        filled = fill_holes(AccumulatedRadiance(mean, spp, spp), coarse.albedo)
        image, state = self.method.denoise(coarse, _one_sample(filled.mean), state)
        light = image / demodulation_albedo(coarse.albedo.clamp(0, 1))
        fine = surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)
        light = upsample_jointly(light, _pool(fine), fine)
        return light * demodulation_albedo(gbuffer.albedo.clamp(0, 1)), state


def upsample_jointly(
    image: Float[Tensor, "n c h2 w2"],
    coarse: Float[Tensor, "n 7 h2 w2"],
    fine: Float[Tensor, "n 7 h w"],
) -> Float[Tensor, "n c h w"]:
    """The image at twice the resolution: bilinear weights times similarity of surfaces.

    `coarse` and `fine` are `surface_features`. Sides are h2 = ceil(h / 2), w2 = ceil(w / 2).
    """
    rows, columns = (_taps(size, image.device) for size in fine.shape[-2:])
    total = weights = torch.zeros((), device=image.device)
    for (row, of_row), (column, of_column) in product(rows, columns):
        tap = coarse[..., row, :][..., column]
        weight = of_row * of_column * (feature_similarity(fine, tap, EDGE_FALLOFF) + MIN_SIMILARITY)
        total = total + weight * image[..., row, :][..., column]
        weights = weights + weight
    return total / weights


def _taps(size: int, device: torch.device) -> list[tuple[Int[Tensor, " s"], float]]:
    """For each fine pixel of an axis the nearer and the farther coarse pixel, and their weights."""
    fine = torch.arange(size, device=device)
    near = fine // 2
    far = (near + 2 * (fine % 2) - 1).clamp(0, (size - 1) // 2)
    return [(near, NEAR), (far, FAR)]


def _limited_radiance(samples: Samples) -> AccumulatedRadiance:
    return frame_radiance(limit_fireflies(samples.radiance, samples.counts), samples.counts)


def _one_sample(radiance: Float[Tensor, "n 3 h w"]) -> Samples:
    return Samples(radiance.unsqueeze(1), torch.ones_like(radiance[:, :1], dtype=torch.int64))


def _pool(image: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h2 w2"]:
    """The mean of 2 x 2 pixels; the last row and column are repeated where a side is odd."""
    return block_mean(pad(image, 2), 2)
