"""The ideas of NTAS and DASR from the start of `oidn/tuned`: OIDN's U-Net with Intel's weights.

`ntas/intel` and `dasr/intel` have the inputs, transfer function, loss and learning rate of the
other rows that start from Intel's weights, so a difference to these is one of ideas. Before
training their first image is that of `oidn`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from baselines.oidn.method import (
    INPUT_CHANNELS,
    Decode,
    published_network,
    run_network,
    to_radiance,
    to_signed_radiance,
    widen,
)
from baselines.oidn.train import frame_losses, recurrent_task
from rlbench.family import Traits
from rlbench.frames import Clip, GBuffer, Samples, Size
from rlbench.ops.asking import next_age
from rlbench.ops.density import bounded_exp_density
from rlbench.ops.exposure import autoexposure
from rlbench.ops.fireflies import mean_without_fireflies, repair_radiance_history
from rlbench.ops.reprojection import reproject
from rlbench.ops.transfer import pu_forward
from rlbench.ops.unet import UNet
from rlbench.training import BUDGETS_FROM_1_SPP, SurrogateGradient, TrainingTask
from rlbench.weights import load_for_inference

LR_MULTIPLIERS = {"sampler": 2.5}  # learning rate 1e-4, as in `ntas` and `dasr`


class Networks(nn.Module):
    """Sampler and denoiser, both U-Nets of OIDN, trained and stored together."""

    def __init__(self, temporal: bool) -> None:
        """`temporal` networks also read the last image, or where it is known."""
        super().__init__()
        self.sampler = UNet(INPUT_CHANNELS + temporal, 1)
        self.denoiser = UNet(INPUT_CHANNELS + 4 * temporal)

    def start_from_intel(self) -> str:
        """Set Intel's weights, zero for new inputs, and a uniform density; returns their origin."""
        intel, origin = published_network()
        widen(self.denoiser, intel)
        widen(self.sampler, intel)
        for weight in self.sampler.dec_conv0.parameters():
            nn.init.zeros_(weight)
        return origin


class LastImage(NamedTuple):
    """The state of a temporal method."""

    image: Float[Tensor, "n 3 h w"]  # linear radiance
    age: int  # frames so far; at 0 `image` is meaningless


@dataclass(frozen=True)
class EqualStart:
    """A sampler and a denoiser that start as `oidn` with uniform samples.

    Temporal (the idea of NTAS, Hasselgren et al. 2020): the sampler maps the reprojected last
    image, in place of noisy radiance, to the logarithm of the density, and the denoiser reads that
    image and where it is known beside its own inputs. Otherwise (the idea of DASR, Kuznetsov et al.
    2018): the sampler reads the pilot's mean, and frames are independent. All else of
    the two is left out: kernels, demodulation, their own U-Nets, transfer functions and losses.
    """

    networks: Networks
    traits: Traits
    decode: Decode = field(default=to_radiance)  # network output and exposure to image

    def start(self, size: Size) -> LastImage | None:
        """No history."""
        if not self.traits.temporal:
            return None
        device = next(self.networks.parameters()).device
        return LastImage(torch.zeros(size.n, 3, size.h, size.w, device=device), 0)

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: LastImage | None
    ) -> Float[Tensor, "n 1 h w"]:
        """Density in (0, 1] with maximum 1: the bounded exponential of the sampler's output."""
        more: tuple[Tensor, ...] = ()
        if state is None:
            known = mean_without_fireflies(samples.radiance, samples.counts)
        else:
            known, weight = _reproject(gbuffer, state)
            more = (weight,)
        exposed = known * autoexposure(known)
        return bounded_exp_density(run_network(self.networks.sampler, exposed, gbuffer, *more))

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: LastImage | None
    ) -> tuple[Float[Tensor, "n 3 h w"], LastImage | None]:
        """The image in linear radiance; no gradient passes the state."""
        noisy = mean_without_fireflies(samples.radiance, samples.counts)
        exposure = autoexposure(noisy)
        more: tuple[Tensor, ...] = ()
        if state is not None:
            last, weight = _reproject(gbuffer, state)
            more = (pu_forward(last * exposure), weight)
        output = run_network(self.networks.denoiser, noisy * exposure, gbuffer, *more)
        image = self.decode(output, exposure)
        return image, state and LastImage(image.detach().clamp_min(0), next_age(state.age))


def _reproject(
    gbuffer: GBuffer, state: LastImage
) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 1 h w"]]:
    """The last image as seen from this frame, and 1 where it is known; both 0 elsewhere."""
    last, valid = reproject(repair_radiance_history(state.image), gbuffer.motion)
    valid = valid & (state.age > 0)
    return last.where(valid, 0.0), valid.to(last.dtype)


def build(traits: Traits, device: torch.device, weights: str | None, shipped: Path) -> EqualStart:
    """The method with the weights of a file (its path), "random" ones, or those at `shipped`."""
    networks = Networks(traits.temporal)
    load_for_inference(networks, weights, shipped, device)
    return EqualStart(networks, traits)


def training_task(traits: Traits, device: torch.device) -> TrainingTask:
    """Intel's weights, and the loss, rate and steps of `accumulate/tuned` and `ours`.

    The sampler learns by the surrogate gradient, as those of `ntas` and `dasr`.
    """
    networks = Networks(traits.temporal)
    origin = networks.start_from_intel()
    method = EqualStart(networks.to(device), traits, decode=to_signed_radiance)

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        return frame_losses(SurrogateGradient(method, iter(clip), spp), clip, spp)

    return recurrent_task(method, networks, losses, origin, BUDGETS_FROM_1_SPP, LR_MULTIPLIERS)
