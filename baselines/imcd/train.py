"""Train IMCD: relative error of images and of their change over time, on pairs of frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.accumulate.memory import LightHistory
from baselines.imcd import FAMILY
from baselines.imcd.method import VARIANTS, Imcd
from baselines.imcd.network import Kernels, Networks
from rlbench.frames import Clip, GBuffer, Samples
from rlbench.ops.losses import smape
from rlbench.run import unroll
from rlbench.training.task import BUDGETS_FROM_1_SPP, TrainingTask
from rlbench.wrappers import MethodWrapper

TEMPORAL_WEIGHT = 0.25  # of the error of the change from the previous frame
SHARPNESS_WEIGHT = 1e-5  # of the mean squared sharpness


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """IMCD with seeded weights and its loss, eq. 11 to 13 of Isik et al. 2021.

    SMAPE of the image, plus 0.25 SMAPE of its change from the previous frame, both against the
    reference, plus 1e-5 times the mean of a^2 + b^2 over pixels and passes.

    Ours, because it could not be verified: images are compared in linear radiance with albedo, not
    clamped. SMAPE is relative, so dark and bright pixels weigh the same without a transfer
    function, and in radiance, unlike in demodulated irradiance, errors that albedo hides do not
    count. Also ours: the epsilon of 0.01, the budgets, and that all frames of each `bptt` count.
    The schedule is the one that all methods here share.
    """
    networks = Networks()
    networks.init_weights(seed)
    networks.to(device)
    method = Imcd(networks, VARIANTS[variant], FAMILY.variants[variant].traits)
    return TrainingTask(method, networks, partial(losses, method), BUDGETS_FROM_1_SPP)


def losses(method: Imcd, clip: Clip, spp: float) -> Iterator[Float[Tensor, ""]]:
    """One loss for each `bptt` frames, the mean of the frames' losses; see `training_task`."""
    recorder = SharpnessRecorder(method)
    frames = (
        (r.image, r.frame.reference.mean, SHARPNESS_WEIGHT * recorder.penalties.pop())
        for r in unroll(recorder, clip, spp)
    )
    return image_and_change_losses(frames, smape, TEMPORAL_WEIGHT, method.config.bptt)


def image_and_change_losses(
    frames: Iterable[tuple[Tensor, Tensor, Tensor | float]],
    error: Callable[[Tensor, Tensor], Tensor],
    change_weight: float,
    bptt: int,
) -> Iterator[Float[Tensor, ""]]:
    """The mean over each `bptt` frames of the error of an image and of its change, and a penalty.

    `frames` are images, references and penalties. The last images may be fewer than `bptt`.
    """
    frame_losses: list[Tensor] = []  # since the last yield
    previous: tuple[Tensor, Tensor] | None = None  # image and reference of the previous frame
    for image, reference, penalty in frames:
        loss = error(image, reference) + penalty
        if previous is not None:
            change = error(image - previous[0], reference - previous[1])
            loss = loss + change_weight * change
        frame_losses.append(loss)
        previous = image, reference
        if len(frame_losses) == bptt:
            yield torch.stack(frame_losses).mean()
            frame_losses, previous = [], (image.detach(), reference)
    if frame_losses:
        yield torch.stack(frame_losses).mean()


@dataclass(frozen=True)
class SharpnessRecorder(MethodWrapper[Imcd]):
    """The method, while it records the sharpness penalty of each frame's kernels."""

    penalties: list[Tensor] = field(default_factory=list)  # of frames that were not yet read

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: LightHistory
    ) -> tuple[Float[Tensor, "n 3 h w"], LightHistory]:
        """The method's image and state."""
        image, state, kernels = self.method.denoise_with_kernels(gbuffer, samples, state)
        self.penalties.append(sharpness_penalty(kernels))
        return image, state


def sharpness_penalty(kernels: Kernels) -> Float[Tensor, ""]:
    """Mean of a^2 over passes and pixels plus mean of b^2 over pixels."""
    return kernels.sharpness.square().mean() + kernels.temporal_sharpness.square().mean()
