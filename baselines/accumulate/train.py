"""Train OIDN on radiance accumulated by rule, as `ours` is trained: its loss, rate and start."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.accumulate import FAMILY
from baselines.accumulate.memory import Memory
from baselines.accumulate.method import VARIANTS, Accumulate
from baselines.oidn.method import published_network, to_signed_radiance
from baselines.oidn.train import FINE_TUNING_MAX_LR
from rlbench.frames import Clip, GBuffer, Samples
from rlbench.ops.losses import log_loss, log_transfer_loss
from rlbench.run import unroll
from rlbench.training.task import BUDGETS_FROM_0_05_SPP, TrainingTask
from rlbench.wrappers import MethodWrapper


@dataclass(frozen=True)
class DetachedMemory(MethodWrapper[Accumulate]):
    """The control with a memory that no gradient passes: each frame is a step of its own."""

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: Memory
    ) -> tuple[Float[Tensor, "n 3 h w"], Memory]:
        """The image, and a memory without a graph."""
        image, memory = super().denoise(gbuffer, samples, state)
        return image, memory.detach()


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """Intel's network, and the loss of its image after accumulation and blending.

    Loss, learning rate, budgets and start are those of `ours`.
    """
    network, origin = published_network()
    traits = FAMILY.variants[variant].traits
    method = Accumulate(VARIANTS[variant], traits, network.to(device), decode=to_signed_radiance)
    detached = DetachedMemory(method)

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        for result in unroll(detached, clip, spp):
            yield log_loss(log_transfer_loss(result.image, result.frame.reference.mean))

    return TrainingTask(
        method,
        network,
        losses,
        BUDGETS_FROM_0_05_SPP,
        FINE_TUNING_MAX_LR,
        origin=origin,
        pretrained=("",),
    )
