"""How OIDN learns: its own loss, in its transfer space, at the reference's exposure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from baselines.oidn.method import INPUTS, VARIANTS, Oidn
from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import Clip
from rlbench.ops.exposure import autoexposure
from rlbench.ops.losses import UNIFORM_WEIGHTS, l1_ms_ssim_loss, log_loss
from rlbench.ops.transfer import pu_forward
from rlbench.ops.unet import UNet
from rlbench.run import unroll
from rlbench.training import BUDGETS_FROM_1_SPP, TrainingTask

PEAK = 1e-3  # learning rate
TUNING = 4e-5  # the same, where training starts from Intel's weights


def trainer(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """A seeded U-Net and its loss, 0.16 L1 + 0.84 (1 - MS-SSIM) with five equal scales.

    As in OIDN's training toolkit (Afra 2019), exposure comes from the reference, and output and
    reference are compared in transfer space, where display white at an exposure of 1 lies at 0.319.
    Differs from it in what all methods here share: crops, schedule, averaged weights; normals
    are not permuted; and crops below 176 pixels use the scales that fit. What starts from Intel's
    weights is tuned as `ours` is, at its rate and with the logarithm of the loss. Raises
    LibraryError where Intel's weights are wanted and the extra `oidn` is not installed.
    """
    config = VARIANTS[variant]
    network = UNet(INPUTS, widths=config.widths, seed=seed).to(device)
    return (tuning if config.intel else learning)(Oidn(network))


def tuning(method: Oidn) -> TrainingTask:
    """How a U-Net goes on from Intel's weights. Raises LibraryError without the extra `oidn`."""
    from baselines.oidn_intel import networks

    known = networks.network(method.network.widths).state_dict()
    method.network.load_state_dict(known)
    return replace(learning(method, TUNING, even=True), origin=networks.origin())


def learning(method: Oidn, peak: float = PEAK, even: bool = False) -> TrainingTask:
    """How a U-Net learns from the pool that the method's traits name; even: by decibels."""

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        for frame in clip:
            loss = _loss(method, InMemoryClip(clip.name, clip.scene, clip.digest, [frame]), spp)
            yield log_loss(loss) if even else loss

    return TrainingTask(method, method.network, losses, BUDGETS_FROM_1_SPP, peak)


def _loss(method: Oidn, still: InMemoryClip, spp: float) -> Tensor:
    reference = still.frames[0].reference.mean
    exposure = autoexposure(reference)
    # the network's output as it is, no clamp: what is clamped gets no gradient
    method = replace(method, expose=lambda noisy: exposure, develop=lambda value, _: value)
    (shown,) = unroll(method, still, spp)
    return l1_ms_ssim_loss(shown.image, pu_forward(reference * exposure), UNIFORM_WEIGHTS)
