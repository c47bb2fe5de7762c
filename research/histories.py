"""A plugin: `accumulate/tuned` with more history for its network, started from its weights.

A pixel takes 93 k multiply-adds (control) to 101 k (splat), and 60 bytes of state or 64 (two, all).

Command: rlbench train --plugin research/histories.py -m histories/two
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.accumulate import ADAPTIVE
from baselines.accumulate.density import contrast, mix_with_uniform
from baselines.accumulate.memory import (
    History,
    Memory,
    accumulate_samples,
    empty_memory,
    reproject_memory,
    share_by_spp,
)
from baselines.accumulate.method import BLEND, Decode, accumulated_network
from baselines.oidn.method import (
    INPUT_CHANNELS,
    run_network,
    to_radiance,
    to_signed_radiance,
    widen,
)
from baselines.oidn.train import DetachedState, frame_losses, recurrent_task
from rlbench.family import Family, Traits, Variant
from rlbench.frames import Clip, GBuffer, Samples, Size
from rlbench.ops.accumulation import (
    AccumulatedRadiance,
    fill_holes,
    surface_features,
)
from rlbench.ops.exposure import autoexposure
from rlbench.ops.kernels import splat_kernels
from rlbench.ops.reprojection import ReprojectionMemo, reproject_bicubic
from rlbench.ops.sanitize import repair_history
from rlbench.ops.transfer import log_forward, log_inverse, pu_forward
from rlbench.ops.unet import UNet
from rlbench.training.task import TrainingTask
from rlbench.weights import load_for_inference

SHORT, LONG = 0.5, 0.95  # largest weights of the old light in a frame
TAPS = 25  # of the kernel that splats the last image
CENTRE_LOGIT = 12.0  # of the kernel's middle tap at the start: the image stays where it is
KERNEL_GAIN = 10.0  # of the kernel's logits, since weights learn slowly next to so large a bias
MAX_HALF = 6e4  # of what is kept in half precision
MANY = 4.0  # samples: half of the range of the count that the network sees


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants."""

    two: bool = False  # short and long radiance are inputs, as that of the rule is
    first: bool = False  # samples behind the history are an input
    splat: bool = False  # the network predicts how the last image is splatted and blended
    through: bool = False  # one loss, and gradients through all frames of a sequence

    @property
    def inputs(self) -> int:
        """Channels of the network's input."""
        return INPUT_CHANNELS + 6 * self.two + self.first

    @property
    def outputs(self) -> int:
        """Channels of its output: colour, and with `splat` a kernel and a mix."""
        return 3 + (TAPS + 1) * self.splat


VARIANTS = {
    "control": Config(),
    "control-through": Config(through=True),
    "two": Config(two=True),
    "two-through": Config(two=True, through=True),
    "first": Config(first=True),
    "splat": Config(splat=True, through=True),
    "all": Config(two=True, first=True),
}


@dataclass(frozen=True, eq=False)
class State:
    """What is carried: at most 64 bytes a pixel.

    The change of the memory is not used and takes no room. With two more histories, image, count
    and the root of the second moment are float16.
    """

    memory: Memory
    recent: Float[Tensor, "n c h w"]  # short, long in log transfer, samples of long; float16

    def detach(self) -> State:
        """The same state without the autograd graph."""
        return State(self.memory.detach(), self.recent.detach())


class Moved(NamedTuple):
    """The state at the pixels of the current frame."""

    history: History
    recent: Float[Tensor, "n c h w"]

    @property
    def image(self) -> Float[Tensor, "n 3 h w"]:
        """The last image, in log transfer."""
        return self.history.image


@dataclass(frozen=True)
class Histories:
    """`accumulate/tuned` with the histories of its config."""

    config: Config
    network: UNet
    traits: Traits = ADAPTIVE
    decode: Decode = field(default=to_radiance)
    memo: ReprojectionMemo[Moved] = field(
        default_factory=ReprojectionMemo, repr=False, compare=False
    )

    def start(self, size: Size) -> State:
        """No history."""
        memory = empty_memory(size, next(self.network.parameters()).device)
        recent = memory.image.new_zeros(size.n, 7 * self.config.two, size.h, size.w).half()
        return State(memory, recent)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The density by contrast of the last image; uniform in the first frame."""
        if state.memory.age == 0:
            return torch.ones_like(gbuffer.depth)
        moved = self.memo.get(gbuffer, state, _reproject)
        return mix_with_uniform(contrast(moved), moved.history.similarity)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The image in linear radiance, and the state after it."""
        moved = self.memo.get(gbuffer, state, _reproject)
        current, accumulated, history = accumulate_samples(samples, moved.history)
        accumulated = fill_holes(accumulated, gbuffer.albedo)
        exposure = autoexposure(accumulated.mean.detach())
        more: list[Tensor] = []
        recent = moved.recent
        if self.config.two:
            recent = _blend_recent(recent, current, history, gbuffer)
            more += [pu_forward(log_inverse(part) * exposure) for part in recent[:, :6].chunk(2, 1)]
        if self.config.first:
            behind = history.radiance.accumulated_spp
            more.append(behind / (behind + MANY))
        output = run_network(self.network, accumulated.mean * exposure, gbuffer, *more)
        denoised = log_forward(self.decode(output[:, :3], exposure))
        old = history.image
        mix: Tensor | float = BLEND
        if self.config.splat:
            old = splat_kernels((KERNEL_GAIN * output[:, 3 : 3 + TAPS]).softmax(1), old)
            mix = output[:, 3 + TAPS :].sigmoid()
        weight = mix * history.similarity * share_by_spp(samples.slot_spp)
        image = log_inverse(torch.lerp(denoised, old, weight))
        surface = surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)
        unused = image.new_zeros(1, 1, 1, 1)
        memory = Memory(accumulated, image, unused, surface, state.memory.age + 1)
        return image, _pack(memory, recent) if self.config.two else State(memory, recent)


def _pack(memory: Memory, recent: Tensor) -> State:
    """The state with all that bears it in half precision."""
    mean, square, spp = memory.radiance
    radiance = AccumulatedRadiance(mean, _half(square.clamp_min(0).sqrt()), _half(spp))
    return State(replace(memory, radiance=radiance, image=_half(memory.image)), _half(recent))


def _half(values: Tensor) -> Tensor:
    return values.clamp(-MAX_HALF, MAX_HALF).half()


def _reproject(gbuffer: GBuffer, state: State) -> Moved:
    spp = state.memory.radiance.accumulated_spp
    memory = replace(state.memory, change=state.memory.change.expand_as(spp))
    if state.recent.shape[1]:
        mean, root, spp = memory.radiance
        radiance = AccumulatedRadiance(mean, root.float().square(), spp.float())
        memory = replace(memory, radiance=radiance, image=memory.image.float())
    history = reproject_memory(gbuffer, memory)
    recent = repair_history(state.recent.float(), -MAX_HALF, MAX_HALF)
    if recent.shape[1]:
        recent = reproject_bicubic(recent, gbuffer.motion)[0]
    return Moved(history, recent)


def _blend_recent(
    recent: Float[Tensor, "n 7 h w"],
    current: AccumulatedRadiance,
    history: History,
    gbuffer: GBuffer,
) -> Float[Tensor, "n 7 h w"]:
    """Short and long radiance with this frame; a pixel without a new sample keeps its history."""
    new, spp = log_forward(fill_holes(current, gbuffer.albedo).mean), current.accumulated_spp
    short, long, behind = recent.split_with_sizes([3, 3, 1], 1)
    behind = behind.clamp_min(0) * history.similarity
    share = behind / (behind + spp).clamp_min(1e-6)
    all_old = (behind > 0).to(new.dtype)  # of a pixel without a sample
    blended = [
        torch.lerp(new, old, share.clamp_max(most).where(spp > 0, all_old))
        for old, most in ((short, SHORT), (long, LONG))
    ]
    return torch.cat((*blended, behind + spp), 1)


def build(variant: str, device: torch.device, weights: str | None) -> Histories:
    """A variant with the weights of a file (its path), or "random" ones."""
    config = VARIANTS[variant]
    network = UNet(config.inputs, config.outputs)
    shipped = Path(__file__).parent / FAMILY.weights_file(variant)
    load_for_inference(network, weights, shipped, device)
    return Histories(config, network)


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """Loss, rate and budgets of `accumulate/tuned`, and its weights: new inputs have no effect."""
    config, (source, origin) = VARIANTS[variant], accumulated_network()
    network = UNet(config.inputs, config.outputs)
    with torch.no_grad():
        widen(network, source)
        if config.splat:
            network.dec_conv0.weight[3:].zero_()
            bias = network.dec_conv0.bias
            assert bias is not None
            bias[3:].zero_()
            bias[3 + TAPS // 2] = CENTRE_LOGIT / KERNEL_GAIN
            bias[3 + TAPS] = math.log(BLEND / (1 - BLEND))
    method = Histories(config, network.to(device), decode=to_signed_radiance)

    def through(clip: Clip, spp: float) -> Iterator[Tensor]:
        yield torch.stack(list(frame_losses(method, clip, spp))).mean()

    losses = through if config.through else partial(frame_losses, DetachedState(method))
    return recurrent_task(method, network, losses, origin)


FAMILY = Family(
    name="histories",
    title="Histories for accumulate/tuned",
    paper="",
    licence="Apache-2.0",
    variants={
        name: Variant(f"What does the history {name} give?", ADAPTIVE, pretrained=False)
        for name in VARIANTS
    },
    build=f"{__name__}:build",
    train=f"{__name__}:training_task",
)
