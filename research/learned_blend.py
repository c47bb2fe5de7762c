"""A learned weight of the last image, trained alone, against the rule of 0.3 times similarity.

Command: python -m research.learned_blend --train CLIPS --score CLIPS

The images before blending are those of `accumulate/tuned`, recorded once. A network then learns the
weight of the last image from its evidence: the difference of both images, its
distance from the new image's neighbourhood, similarity, samples and deviation of history and frame,
and how many images the last one is worth. Gradients flow through eight frames. The loss is PSNR.
"""

from __future__ import annotations

import argparse
import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import torch
from jaxtyping import Float
from rich.console import Console
from torch import Tensor, nn
from torch.nn import functional as F

from baselines.accumulate.memory import History
from baselines.accumulate.method import BLEND, Accumulate
from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.ops.color import encode_srgb, luminance
from rlbench.ops.reprojection import reproject, reproject_bicubic
from rlbench.ops.transfer import log_inverse
from rlbench.run import run_clip

MIN_MSE = 1e-10  # 100 dB
PROGRAM = "python -m research.learned_blend"
RULE = "accumulate/tuned"
WIDTH, INPUTS = 16, 15
CROP, FRAMES = 112, 8
MANY = 8.0  # samples: half of the range of a count
FLOOR = 2e-4  # of a squared error in the loss, so that easy clips do not rule

Weigh = Callable[[Float[Tensor, "n c h w"], Float[Tensor, "n 1 h w"]], Float[Tensor, "n 1 h w"]]


class BlendFrame(NamedTuple):
    """What a blend may read of a frame, and the reference."""

    denoised: Float[Tensor, "n 3 h w"]  # before blending, in log transfer
    similarity: Float[Tensor, "n 1 h w"]  # of surfaces, times confidence, in [0, 1]
    statistics: Float[Tensor, "n 6 h w"]  # shares of samples, errors and change, about [0, 4]
    motion: Float[Tensor, "n 2 h w"]
    reference: Float[Tensor, "n 3 h w"]  # display values, [0, 1]


@dataclass(frozen=True)
class Recorder(Accumulate):
    """The rule, which keeps the image before blending and its history."""

    seen: list[tuple[Tensor, History]] = field(default_factory=list, compare=False)

    def blend_weight(
        self, denoised: Float[Tensor, "n 3 h w"], history: History
    ) -> Float[Tensor, "n 1 h w"]:
        """The weight of the rule."""
        self.seen.append((denoised, history))
        return super().blend_weight(denoised, history)


class BlendNetwork(nn.Module):
    """A logit for each pixel: a 1x1 path, and 3x3 convolutions at 1/2, 1/4, 1/8 and 1/16."""

    def __init__(self) -> None:
        """The network, whose weight is that of the rule before training."""
        super().__init__()
        self.scales = nn.ModuleList(
            nn.Conv2d(INPUTS if n == 0 else WIDTH, WIDTH, 3, padding=1) for n in range(4)
        )
        self.merge = nn.Conv2d(4 * WIDTH, WIDTH, 1)
        self.coarse = nn.Conv2d(WIDTH, 1, 3, padding=1)
        self.hidden, self.fine = nn.Conv2d(INPUTS, 8, 1), nn.Conv2d(8, 1, 1)
        for last in (self.coarse, self.fine):
            nn.init.zeros_(last.weight)
            assert last.bias is not None
            nn.init.constant_(last.bias, math.log(BLEND / (1 - BLEND)) / 2)

    def forward(self, features: Float[Tensor, "n c h w"]) -> Float[Tensor, "n 1 h w"]:
        """The logit of the weight."""
        h, w = features.shape[-2:]
        level = F.pad(features, (0, -w % 16, 0, -h % 16), mode="replicate")
        size, levels = (level.shape[-2:], [])
        for convolution in self.scales:
            level = F.leaky_relu(convolution(F.avg_pool2d(level, 2)))
            levels.append(F.interpolate(level, size=(size[0] // 2, size[1] // 2), mode="bilinear"))
        merged = F.leaky_relu(self.merge(torch.cat(levels, dim=1)))
        coarse = F.interpolate(self.coarse(merged), size=size, mode="bilinear")
        fine: Tensor = self.fine(F.leaky_relu(self.hidden(features)))
        return coarse[..., :h, :w] + fine


def record_clip(recorder: Recorder, folder: Path, spp: float) -> list[BlendFrame]:
    """The frames of a clip as the rule reads them, at a budget in samples per pixel."""
    clip, frames = open_clip(folder, recorder.traits.inputs), []
    for result in run_clip(recorder, clip, spp):
        denoised, history = recorder.seen.pop()
        old, new = history.radiance, result.state.radiance
        counts = result.samples.counts.float()
        statistics = torch.cat(
            (
                *(spp / (spp + MANY) for spp in (new.accumulated_spp, counts, old.accumulated_spp)),
                _relative_error(new.variance, new.accumulated_spp, luminance(new.mean)),
                _relative_error(old.variance, counts, luminance(old.mean)),
                4 * history.change.sqrt().clamp_max(1),
            ),
            dim=1,
        )
        motion = result.frame.gbuffer.motion
        motion = torch.zeros_like(denoised[:, :2]) if motion is None else motion
        reference = encode_srgb(result.frame.reference.mean.clamp(0, 1))
        frames.append(BlendFrame(denoised, history.similarity, statistics, motion, reference))
    return [BlendFrame(*(part.clone() for part in frame)) for frame in frames]


def blend_frames(frames: Sequence[BlendFrame], weigh: Weigh) -> list[Tensor]:
    """The squared error on the display of each frame, blended with the weights of `weigh`."""
    image, worth = frames[0].denoised, torch.ones_like(frames[0].similarity)
    errors = [_squared_error(image, frames[0])]
    for frame in frames[1:]:
        old, valid = reproject_bicubic(image, frame.motion)
        old_worth = reproject(worth, frame.motion)[0].clamp_min(0.5)
        weight = weigh(_features(frame, old, old_worth), old_worth) * frame.similarity * valid
        image = torch.lerp(frame.denoised, old, weight)
        worth = (1 / (weight.square() / old_worth + (1 - weight).square())).clamp(0.5, 64)
        errors.append(_squared_error(image, frame))
    return errors


def train_blend(clips: Sequence[Sequence[BlendFrame]], epochs: int, seed: int = 0) -> BlendNetwork:
    """A network trained on crops of recorded clips."""
    torch.manual_seed(seed)
    order, network = random.Random(seed), BlendNetwork()
    optimizer = torch.optim.Adam(network.parameters(), 7e-4)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs * len(clips))
    for _ in range(epochs):
        for frames in order.sample(clips, len(clips)):
            errors = blend_frames(_crop(frames, order), _learned(network))
            loss = torch.stack([(error + FLOOR).log() for error in errors[1:]]).mean()
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            schedule.step()
    return network.requires_grad_(False)


def _learned(network: BlendNetwork) -> Weigh:
    return lambda features, worth: torch.sigmoid(network(features))


def _constant(share: float) -> Weigh:
    return lambda features, worth: torch.full_like(worth, share)


def _features(frame: BlendFrame, old: Tensor, worth: Tensor) -> Tensor:
    new, difference = frame.denoised, frame.denoised - old
    least, largest = -F.max_pool2d(-new, 3, 1, 1), F.max_pool2d(new, 3, 1, 1)
    outside = (old - old.clamp(least, largest)).abs().mean(1, keepdim=True)
    subpixel = (frame.motion - frame.motion.round()).abs().sum(1, keepdim=True)
    parts = (
        4 * difference,
        4 * difference.abs().mean(1, keepdim=True),
        4 * outside,
        frame.similarity,
        frame.statistics,
        worth / (worth + 4),
        new.mean(1, keepdim=True),
        subpixel.where(frame.similarity > 0, 0.0),
    )
    return torch.cat(parts, dim=1).clamp(-4, 4)


def _relative_error(variance: Tensor, spp: Tensor, mean: Tensor) -> Tensor:
    return ((variance / spp.clamp_min(0.25)).sqrt() / (mean.abs() + 0.05)).clamp_max(4)


def _squared_error(image: Tensor, frame: BlendFrame) -> Tensor:
    difference: Tensor = encode_srgb(log_inverse(image).clamp(0, 1)) - frame.reference
    return difference.square().mean()


def _crop(frames: Sequence[BlendFrame], order: random.Random) -> list[BlendFrame]:
    h, w = frames[0].similarity.shape[-2:]
    y, x = order.randrange(max(1, h - CROP + 1)), order.randrange(max(1, w - CROP + 1))
    first = order.randrange(max(1, len(frames) - FRAMES + 1))
    return [
        BlendFrame(*(part[..., y : y + CROP, x : x + CROP] for part in frame))
        for frame in frames[first : first + FRAMES]
    ]


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="PSNR of a learned blend beside fixed weights.",
        epilog=f"example: {PROGRAM} --train ~/clips/train-real/* --score ~/clips/development/*",
    )
    parser.add_argument("--train", type=Path, nargs="+", required=True, help="folders of clips")
    parser.add_argument("--score", type=Path, nargs="+", required=True, help="folders of clips")
    parser.add_argument("--spp", default="1,4", help="budgets of the scores (default: 1,4)")
    parser.add_argument("--epochs", type=int, default=10)
    parser.add_argument("--weights", help="of accumulate/tuned; default: those shipped")
    arguments = parser.parse_args()
    rule = registry.load_method(RULE, torch.device("cpu"), arguments.weights)
    assert isinstance(rule, Accumulate)
    parts = {part.name: getattr(rule, part.name) for part in fields(Accumulate)}
    recorder = Recorder(**parts)
    clips = [
        record_clip(recorder, folder, spp) for folder in arguments.train for spp in (0.5, 1, 2, 4)
    ]
    network, console = train_blend(clips, arguments.epochs), Console()
    blends = {f"{share:g} of similarity": _constant(share) for share in (0.0, BLEND, 0.5)}
    blends["n / (n + 2) of similarity"] = lambda _, worth: worth / (worth + 2)
    blends["learned"] = _learned(network)
    for spp in map(float, arguments.spp.split(",")):
        scored = [record_clip(recorder, folder, spp) for folder in arguments.score]
        for name, weigh in blends.items():
            errors = [torch.stack(blend_frames(frames, weigh)) for frames in scored]
            psnr = fmean((-10 * error.clamp_min(MIN_MSE).log10()).mean().item() for error in errors)
            console.print(f"{spp:g} spp  {name:28} {psnr:.2f} dB")


if __name__ == "__main__":
    main()
