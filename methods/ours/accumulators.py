"""Accumulators: the radiance that the denoiser reads, and the image from its output."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor

from baselines.accumulate.memory import trust_by_rule
from baselines.oidn.method import encode_inputs as oidn_inputs
from baselines.oidn.method import to_signed_radiance
from methods.ours.rejection import HistoryRejection
from methods.ours.sample_encoding import MISSING
from methods.ours.state import ReprojectedHistory, network_features
from rlbench.frames import GBuffer, Samples
from rlbench.ops.accumulation import (
    AccumulatedRadiance,
    accumulate,
    fill_holes,
    frame_radiance,
)
from rlbench.ops.exposure import autoexposure
from rlbench.ops.kernels import apply_kernels
from rlbench.ops.transfer import log_forward, log_inverse

__all__ = ["Accumulator", "FrameRadiance", "RuleRadiance", "StateOnly", "TemporalRadiance"]

Denoiser = Callable[[Float[Tensor, "n c h w"]], Float[Tensor, "n c2 h w"]]


class Accumulator(Protocol):
    """Accumulates radiance before the denoiser and reconstructs the image behind it.

    `trust` in the accumulated radiance, in [0, 1], is an output of the encoder: one channel with
    temporal accumulation, zero channels without.
    """

    def hold_static(
        self,
        latent: Float[Tensor, "n s h w"],
        trust: Float[Tensor, "n _ h w"],
        counts: Int[Tensor, "n 1 h w"],
        history: ReprojectedHistory,
    ) -> tuple[Float[Tensor, "n s h w"], Float[Tensor, "n _ h w"]]:
        """Latent and trust, with those of static pixels that got no sample replaced."""

    def accumulate(
        self,
        gbuffer: GBuffer,
        samples: Samples,
        trust: Float[Tensor, "n _ h w"],
        history: ReprojectedHistory,
    ) -> tuple[AccumulatedRadiance, ReprojectedHistory]:
        """Radiance up to this frame without holes, and the history that was not rejected."""

    def reconstruct(
        self,
        denoiser: Denoiser,
        gbuffer: GBuffer,
        latent: Float[Tensor, "n s h w"],
        radiance: AccumulatedRadiance,
        history: ReprojectedHistory,
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n s h w"]]:
        """The image in linear radiance, and the latent for the next frame."""


@dataclass(frozen=True)
class StateOnly:
    """No radiance: the denoiser reads the recurrent state alone, as in the paper."""

    def hold_static(
        self,
        latent: Float[Tensor, "n s h w"],
        trust: Float[Tensor, "n _ h w"],
        counts: Int[Tensor, "n 1 h w"],
        history: ReprojectedHistory,
    ) -> tuple[Float[Tensor, "n s h w"], Float[Tensor, "n _ h w"]]:
        """Both, unchanged."""
        return latent, trust

    def accumulate(
        self,
        gbuffer: GBuffer,
        samples: Samples,
        trust: Float[Tensor, "n _ h w"],
        history: ReprojectedHistory,
    ) -> tuple[AccumulatedRadiance, ReprojectedHistory]:
        """The history, unchanged, and its radiance, which has zero channels."""
        return history.radiance, history

    def reconstruct(
        self,
        denoiser: Denoiser,
        gbuffer: GBuffer,
        latent: Float[Tensor, "n s h w"],
        radiance: AccumulatedRadiance,
        history: ReprojectedHistory,
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n s h w"]]:
        """The denoiser's output, which is in log transfer, and the same latent."""
        return log_inverse(denoiser(latent)), latent


@dataclass(frozen=True)
class FrameRadiance(StateOnly):
    """The radiance of one frame; the denoiser reads it as Open Image Denoise (Afra 2019) does."""

    def accumulate(
        self,
        gbuffer: GBuffer,
        samples: Samples,
        trust: Float[Tensor, "n _ h w"],
        history: ReprojectedHistory,
    ) -> tuple[AccumulatedRadiance, ReprojectedHistory]:
        """The mean of this frame's samples, with holes filled."""
        return fill_holes(frame_radiance(samples.radiance, samples.counts), gbuffer.albedo), history

    def reconstruct(
        self,
        denoiser: Denoiser,
        gbuffer: GBuffer,
        latent: Float[Tensor, "n s h w"],
        radiance: AccumulatedRadiance,
        history: ReprojectedHistory,
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n s h w"]]:
        """The denoiser's output, un-exposed and out of PU transfer, and the same latent."""
        return _denoise_exposed(denoiser, gbuffer, latent, radiance)[0], latent


@dataclass(frozen=True)
class TemporalRadiance:
    """Radiance accumulated over frames; the image is blended with the previous one.

    The encoder predicts how far the accumulated radiance is trusted, the denoiser how far the
    previous image is kept.
    """

    rejection: HistoryRejection

    def hold_static(
        self,
        latent: Float[Tensor, "n s h w"],
        trust: Float[Tensor, "n _ h w"],
        counts: Int[Tensor, "n 1 h w"],
        history: ReprojectedHistory,
    ) -> tuple[Float[Tensor, "n s h w"], Float[Tensor, "n _ h w"]]:
        """A static pixel trusts its radiance in full, so that its error falls from frame to frame.

        Without samples it keeps its latent too.
        """
        held = history.static_mask & (counts == 0)
        return history.features.where(held, latent), trust.masked_fill(history.static_mask, 1.0)

    def accumulate(
        self,
        gbuffer: GBuffer,
        samples: Samples,
        trust: Float[Tensor, "n _ h w"],
        history: ReprojectedHistory,
    ) -> tuple[AccumulatedRadiance, ReprojectedHistory]:
        """Samples of this frame and trusted history, with holes filled."""
        current = frame_radiance(samples.radiance, samples.counts)
        history = self.rejection.apply(history, current)
        radiance = accumulate(history.radiance, current, trust)
        return fill_holes(radiance, gbuffer.albedo), history

    def reconstruct(
        self,
        denoiser: Denoiser,
        gbuffer: GBuffer,
        latent: Float[Tensor, "n s h w"],
        radiance: AccumulatedRadiance,
        history: ReprojectedHistory,
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n s h w"]]:
        """The denoiser's colour and the previous image, mixed in log transfer; the same latent.

        The weight of the previous image is the denoiser's fourth channel times surface similarity.
        """
        image, blend = _denoise_exposed(denoiser, gbuffer, latent, radiance)
        return mix_with_previous(image, blend, history), latent


@dataclass(frozen=True)
class RuleRadiance(TemporalRadiance):
    """Radiance accumulated by rule; the denoiser reads its statistics, and writes the latent.

    The statistics are the previous image, relative deviation and weight of the radiance, and
    similarity. The denoiser reads the latent of the previous frame, if the variant has one, and its
    last output channels are the next latent. With kernels, it also predicts for each pixel the
    weights of its neighbours' accumulated radiance (Bako et al. 2017), and how far that filtered
    radiance replaces its colour.
    """

    kernel_taps: int = 0  # neighbours of a pixel, with the pixel itself

    def accumulate(
        self,
        gbuffer: GBuffer,
        samples: Samples,
        trust: Float[Tensor, "n _ h w"],
        history: ReprojectedHistory,
    ) -> tuple[AccumulatedRadiance, ReprojectedHistory]:
        """Samples of this frame and history that fades by a fifth, with holes filled."""
        return super().accumulate(gbuffer, samples, trust_by_rule(history.static_mask), history)

    def reconstruct(
        self,
        denoiser: Denoiser,
        gbuffer: GBuffer,
        latent: Float[Tensor, "n s h w"],
        radiance: AccumulatedRadiance,
        history: ReprojectedHistory,
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n s h w"]]:
        """The denoiser's colour and the previous image, mixed in log transfer; the next latent."""
        known = history.similarity > 0
        statistics = network_features(radiance)[:, 3:]  # without the mean, which is an input
        previous = history.image.where(known, MISSING)
        features = torch.cat((previous, statistics, history.similarity, latent), dim=1)
        image, others = _denoise_exposed(denoiser, gbuffer, features, radiance)
        sizes = [1, latent.shape[1], self.kernel_taps and 1, self.kernel_taps]
        blend, written, gate, kernels = others.split_with_sizes(sizes, dim=1)
        if self.kernel_taps:
            filtered = apply_kernels(kernels.softmax(1), radiance.mean)
            mixed = torch.lerp(log_forward(image), log_forward(filtered), gate.sigmoid())
            image = log_inverse(mixed)
        return mix_with_previous(image, blend, history), written.tanh()


def mix_with_previous(
    image: Float[Tensor, "n 3 h w"],
    blend: Float[Tensor, "n 1 h w"],
    history: ReprojectedHistory,
) -> Float[Tensor, "n 3 h w"]:
    """The image mixed with the previous one in log transfer; `blend` is the logit of its weight."""
    weight = blend.sigmoid() * history.similarity
    return log_inverse(torch.lerp(log_forward(image), history.image, weight))


def _denoise_exposed(
    denoiser: Denoiser,
    gbuffer: GBuffer,
    latent: Float[Tensor, "n s h w"],
    radiance: AccumulatedRadiance,
) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n _ h w"]]:
    """Linear radiance from exposed radiance, G-buffer and latent, and the other outputs."""
    exposure = autoexposure(radiance.mean.detach())
    value = denoiser(torch.cat((oidn_inputs(radiance.mean * exposure, gbuffer), latent), dim=1))
    return to_signed_radiance(value[:, :3], exposure), value[:, 3:]
