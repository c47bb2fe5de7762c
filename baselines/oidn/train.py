"""How OIDN learns: its own loss, in its transfer space, at the reference's exposure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from baselines.oidn.method import INPUTS, VARIANTS, Oidn
from rlbench.frames import Clip
from rlbench.memory import MemoryClip
from rlbench.ops.exposure import autoexposure
from rlbench.ops.losses import EVEN, mixed
from rlbench.ops.transfer import pu_forward
from rlbench.ops.unet import UNet
from rlbench.run import unroll
from rlbench.training import Trainer

PEAK = 1e-3  # learning rate
TUNING = 1e-4  # the same, where training starts from Intel's weights
BUDGETS = tuple(float(n) for n in range(1, 9))  # samples per pixel


def trainer(variant: str, device: torch.device, seed: int) -> Trainer:
    """A seeded U-Net and its loss, 0.16 L1 + 0.84 (1 - MS-SSIM) with five equal scales.

    As in OIDN's training toolkit (Afra 2019), exposure comes from the reference, and output and
    reference are compared in transfer space, where display white at an exposure of 1 lies at 0.319.
    Differs from it in what all methods here share: crops, schedule, averaged weights; normals
    are not permuted; and crops below 176 pixels use the scales that fit. Raises LibraryError where
    Intel's weights are wanted and the extra `oidn` is not installed.
    """
    config = VARIANTS[variant]
    network = UNet(INPUTS, widths=config.widths, seed=seed)
    if not config.intel:
        return learning(Oidn(network.to(device)))
    from baselines.oidn_intel import networks

    network.load_state_dict(networks.network(config.widths).state_dict())
    return replace(learning(Oidn(network.to(device)), TUNING), origin=networks.origin())


def learning(method: Oidn, peak: float = PEAK) -> Trainer:
    """How a U-Net learns from the pool that the method's traits name."""

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        for frame in clip:
            yield _loss(method, MemoryClip(clip.name, clip.scene, clip.digest, [frame]), spp)

    return Trainer(method, method.network, losses, BUDGETS, peak)


def _loss(method: Oidn, still: MemoryClip, spp: float) -> Tensor:
    reference = still.frames[0].reference.mean
    exposure = autoexposure(reference)
    # the network's output as it is, no clamp: what is clamped gets no gradient
    method = replace(method, expose=lambda noisy: exposure, develop=lambda value, _: value)
    (shown,) = unroll(method, still, spp)
    return mixed(shown.image, pu_forward(reference * exposure), EVEN)
