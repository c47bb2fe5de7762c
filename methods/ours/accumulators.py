"""Accumulators: the radiance that the denoiser reads, and the image from its output.

`accumulate` returns the radiance up to this frame without holes, and the frame with the history
that is kept. `reconstruct` returns the image in linear radiance, and the latent for the next frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from baselines.accumulate.memory import trust_by_rule
from baselines.oidn.method import encode_inputs as oidn_inputs
from baselines.oidn.method import to_signed_radiance
from methods.ours.history import ReprojectedHistory, radiance_statistics
from methods.ours.networks import MISSING
from rlbench.frames import GBuffer, Samples
from rlbench.ops.accumulation import AccumulatedRadiance, accumulate, fill_holes, frame_radiance
from rlbench.ops.antilag import history_confidence
from rlbench.ops.exposure import autoexposure
from rlbench.ops.kernels import apply_kernels
from rlbench.ops.transfer import log_forward, log_inverse

Denoiser = Callable[[Float[Tensor, "n c h w"]], Float[Tensor, "n c2 h w"]]


class SampledFrame(NamedTuple):
    """What is known of a frame before it is denoised."""

    gbuffer: GBuffer
    samples: Samples
    history: ReprojectedHistory
    latent: Float[Tensor, "n s h w"]
    trust: Float[Tensor, "n _ h w"]  # in accumulated radiance, in [0, 1]; by the encoder


@dataclass(frozen=True)
class StateOnly:
    """No radiance: the denoiser reads the recurrent state alone, as in the paper."""

    def accumulate(self, frame: SampledFrame) -> tuple[AccumulatedRadiance, SampledFrame]:
        """The radiance of the history, which has zero channels."""
        return frame.history.radiance, frame

    def reconstruct(
        self, denoiser: Denoiser, frame: SampledFrame, radiance: AccumulatedRadiance
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n s h w"]]:
        """The denoiser's output, which is in log transfer, and the same latent."""
        return log_inverse(denoiser(frame.latent)), frame.latent


@dataclass(frozen=True)
class FrameRadiance:
    """The radiance of one frame; the denoiser reads it as Open Image Denoise (Afra 2019) does."""

    def accumulate(self, frame: SampledFrame) -> tuple[AccumulatedRadiance, SampledFrame]:
        """The mean of this frame's samples, with holes filled."""
        return fill_holes(_current_radiance(frame), frame.gbuffer.albedo), frame

    def reconstruct(
        self, denoiser: Denoiser, frame: SampledFrame, radiance: AccumulatedRadiance
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n s h w"]]:
        """The denoiser's output, un-exposed and out of PU transfer, and the same latent."""
        return _denoise_exposed(denoiser, frame.gbuffer, frame.latent, radiance)[0], frame.latent


@dataclass(frozen=True)
class TemporalRadiance:
    """Radiance accumulated over frames; the image is blended with the previous one.

    The encoder predicts how far the accumulated radiance is trusted, the denoiser how far the
    previous image is kept.
    """

    antilag: bool  # reduce history where new samples contradict it (`history_confidence`)

    def accumulate(self, frame: SampledFrame) -> tuple[AccumulatedRadiance, SampledFrame]:
        """Samples of this frame and trusted history, with holes filled."""
        current, history = _current_radiance(frame), frame.history
        if self.antilag:
            confidence = history_confidence(history.radiance, current, history.image)
            history = history.with_confidence(confidence)
        radiance = accumulate(history.radiance, current, frame.trust)
        return fill_holes(radiance, frame.gbuffer.albedo), frame._replace(history=history)

    def reconstruct(
        self, denoiser: Denoiser, frame: SampledFrame, radiance: AccumulatedRadiance
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n s h w"]]:
        """The denoiser's colour and the previous image, mixed in log transfer; the same latent.

        The weight of the previous image is the denoiser's fourth channel times surface similarity.
        """
        image, blend = _denoise_exposed(denoiser, frame.gbuffer, frame.latent, radiance)
        return mix_with_previous(image, blend, frame.history), frame.latent


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

    def accumulate(self, frame: SampledFrame) -> tuple[AccumulatedRadiance, SampledFrame]:
        """Samples of this frame and history that fades by a fifth, with holes filled."""
        return super().accumulate(frame._replace(trust=trust_by_rule(frame.history.static_mask)))

    def reconstruct(
        self, denoiser: Denoiser, frame: SampledFrame, radiance: AccumulatedRadiance
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n s h w"]]:
        """The denoiser's colour and the previous image, mixed in log transfer; the next latent."""
        history, latent = frame.history, frame.latent
        is_similar = history.similarity > torch.finfo(torch.float32).tiny  # also in float64
        previous = history.image.where(is_similar, MISSING)
        statistics = radiance_statistics(radiance)
        features = torch.cat((previous, statistics, history.similarity, latent), dim=1)
        image, others = _denoise_exposed(denoiser, frame.gbuffer, features, radiance)
        sizes = [1, latent.shape[1], self.kernel_taps and 1, self.kernel_taps]
        blend, written, gate, kernels = others.split_with_sizes(sizes, dim=1)
        if self.kernel_taps:
            filtered = apply_kernels(kernels.softmax(1), radiance.mean)
            mixed = torch.lerp(log_forward(image), log_forward(filtered), gate.sigmoid())
            image = log_inverse(mixed)
        return mix_with_previous(image, blend, history), written.tanh()


Accumulator = StateOnly | FrameRadiance | TemporalRadiance


def hold_static(
    latent: Float[Tensor, "n s h w"],
    trust: Float[Tensor, "n 1 h w"],
    counts: Int[Tensor, "n 1 h w"],
    history: ReprojectedHistory,
) -> tuple[Float[Tensor, "n s h w"], Float[Tensor, "n 1 h w"]]:
    """Latent and trust; a static pixel trusts its radiance in full, so that its error falls.

    Without samples it keeps its latent too.
    """
    held = history.static_mask & (counts == 0)
    return history.features.where(held, latent), trust.masked_fill(history.static_mask, 1.0)


def mix_with_previous(
    image: Float[Tensor, "n 3 h w"], blend: Float[Tensor, "n 1 h w"], history: ReprojectedHistory
) -> Float[Tensor, "n 3 h w"]:
    """The image mixed with the previous one in log transfer; `blend` is the logit of its weight."""
    weight = blend.sigmoid() * history.similarity
    return log_inverse(torch.lerp(log_forward(image), history.image, weight))


def _current_radiance(frame: SampledFrame) -> AccumulatedRadiance:
    return frame_radiance(frame.samples.radiance, frame.samples.counts)


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
