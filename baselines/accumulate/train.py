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
from baselines.oidn.method import INPUT_CHANNELS
from rlbench.frames import Clip, GBuffer, Samples
from rlbench.ops.losses import l1_ms_ssim_loss, log_loss
from rlbench.ops.transfer import LOG_SCALE, log_forward, pu_inverse
from rlbench.ops.unet import UNet
from rlbench.run import unroll
from rlbench.training.task import BUDGETS_FROM_1_SPP, TrainingTask
from rlbench.wrappers import MethodWrapper

__all__ = ["BUDGETS", "training_task"]

MAX_LR = 4e-5  # as all training here that starts from Intel's weights
BUDGETS = (0.05, 0.25, 0.5, *BUDGETS_FROM_1_SPP)  # spp, one drawn for each sequence; as for `ours`
MIN_RADIANCE = -0.5 / LOG_SCALE  # log transfer is defined above twice this


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

    Loss, learning rate, budgets and start are those of `ours`. Raises LibraryError if the extra
    `oidn` is not installed.
    """
    from baselines.oidn_intel import networks

    network = UNet(INPUT_CHANNELS, seed=seed)
    network.load_state_dict(networks.load_network().state_dict())
    traits = FAMILY.variants[variant].traits
    method = Accumulate(VARIANTS[variant], traits, network.to(device), decode=decode_signed)
    detached = DetachedMemory(method)

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        for result in unroll(detached, clip, spp):
            reference = log_forward(result.frame.reference.mean)
            yield log_loss(l1_ms_ssim_loss(log_forward(result.image), reference))

    origin = networks.weights_origin()
    return TrainingTask(method, network, losses, BUDGETS, MAX_LR, origin=origin)


def decode_signed(
    value: Float[Tensor, "n 3 h w"], exposure: Float[Tensor, "n 1 1 1"]
) -> Float[Tensor, "n 3 h w"]:
    """Linear radiance from the network's output, not clamped at 0, where gradients would end."""
    return (pu_inverse(value.clamp_max(1)) / exposure).clamp_min(MIN_RADIANCE)
