"""Train OIDN with its own loss, in transfer space, at the exposure of the reference."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from baselines.oidn.method import INPUT_CHANNELS, VARIANTS, Oidn, published_network
from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import Clip, GBuffer, Samples
from rlbench.method import Method, State
from rlbench.ops.exposure import autoexposure
from rlbench.ops.losses import UNIFORM_WEIGHTS, l1_ms_ssim_loss, log_loss, log_transfer_loss
from rlbench.ops.transfer import pu_forward
from rlbench.ops.unet import UNet
from rlbench.run import unroll
from rlbench.training.task import BUDGETS_FROM_0_05_SPP, BUDGETS_FROM_1_SPP, TrainingTask
from rlbench.wrappers import MethodWrapper

MAX_LR = 1e-3
FINE_TUNING_MAX_LR = 4e-5  # for training that starts from Intel's weights


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """A seeded U-Net and its loss, 0.16 L1 + 0.84 (1 - MS-SSIM) with five equal scales.

    As in OIDN's training toolkit (Afra 2019), the exposure comes from the reference, and output and
    reference are compared in transfer space, where display white at exposure 1 is 0.319. Differs
    from it in what all methods here share: crops, schedule, averaged weights; normals are not
    permuted; and crops below 176 pixels use the scales that fit. The variant `tuned` starts from
    Intel's weights and is fine-tuned as `ours` is, with its learning rate and the logarithm of the
    loss. `rlbench.registry.training_task` refuses the variants with Intel's weights.
    """
    config = VARIANTS[variant]
    network = UNet(INPUT_CHANNELS, widths=config.widths, seed=seed).to(device)
    make_task = fine_tuning_task if config.starts_from_intel else _task
    return make_task(Oidn(network))


def fine_tuning_task(method: Oidn) -> TrainingTask:
    """Fine-tuning of `method` from Intel's weights, on the pool that the method's traits name.

    Loads Intel's weights into the method's network.
    """
    assert isinstance(method.network, UNet)
    intel, origin = published_network(method.network.widths)
    method.network.load_state_dict(intel.state_dict())
    return replace(_task(method, FINE_TUNING_MAX_LR, log_loss), origin=origin, pretrained=("",))


@dataclass(frozen=True)
class DetachedState(MethodWrapper[Method]):
    """A method with a state that no gradient passes: each frame is a step of its own.

    The state has a method `detach`.
    """

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The image, and a state without a graph."""
        image, state = super().denoise(gbuffer, samples, state)
        return image, state.detach()


def frame_losses(method: Method, clip: Clip, spp: float) -> Iterator[Tensor]:
    """The loss of each frame of a clip, as that of `ours`."""
    for result in unroll(method, clip, spp):
        yield log_loss(log_transfer_loss(result.image, result.frame.reference.mean))


def recurrent_task(
    method: Method,
    networks: nn.Module,
    losses: Callable[[Clip, float], Iterator[Tensor]],
    origin: str,
    spp: tuple[float, ...] = BUDGETS_FROM_0_05_SPP,
    lr_multipliers: Mapping[str, float] | None = None,
) -> TrainingTask:
    """Fine-tuning of networks that start from Intel's weights, at the learning rate of `ours`."""
    rates = lr_multipliers or {}
    return TrainingTask(
        method, networks, losses, spp, FINE_TUNING_MAX_LR, rates, origin=origin, pretrained=("",)
    )


def _task(
    method: Oidn,
    max_lr: float = MAX_LR,
    transform_loss: Callable[[Tensor], Tensor] = lambda loss: loss,
) -> TrainingTask:
    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        for frame in clip:
            single = InMemoryClip(clip.name, clip.scene, clip.digest, [frame])
            yield transform_loss(_frame_loss(method, single, spp))

    return TrainingTask(method, method.network, losses, BUDGETS_FROM_1_SPP, max_lr)


def _frame_loss(method: Oidn, clip: InMemoryClip, spp: float) -> Tensor:
    """The loss of a clip's only frame."""
    reference = clip.frames[0].reference.mean
    exposure = autoexposure(reference)
    # compare the raw output: clamped values would get no gradient
    method = replace(
        method, estimate_exposure=lambda noisy: exposure, decode=lambda output, _: output
    )
    (result,) = unroll(method, clip, spp)
    return l1_ms_ssim_loss(result.image, pu_forward(reference * exposure), UNIFORM_WEIGHTS)
