"""What could be won: density, blend and samples of one rule, replaced by those that know the truth.

Command: python -m research.bounds CLIPS --spp 1

The rule is `accumulate/contrast`. Each row replaces one part of it and keeps the others:

- uniform samples in place of the contrast rule
- a density that knows the squared error of this very frame, as another order of samples gave it,
  averaged over a window; samples in proportion to its root
- a blend of the new and the last denoised image that knows which is nearer to the truth, in windows
- more samples
- the first frame by `oidn`, which has no memory

An oracle reads one half of the reference and is judged by the other, less that half's noise, so it
does not fit the noise of the reference. Its images stay in the memory, so what it wins in one frame
helps the next.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import torch
from jaxtyping import Float
from rich.progress import track
from torch import Tensor

from baselines.accumulate.density import mix_with_uniform
from baselines.accumulate.memory import History, Memory
from baselines.accumulate.method import Accumulate
from research.clips import add_clips, print_gains, read_cells
from rlbench import registry
from rlbench.clips.stored import StoredClip, open_clip
from rlbench.frames import GBuffer, Samples
from rlbench.method import Method
from rlbench.ops.box_filter import box_mean
from rlbench.ops.transfer import log_forward
from rlbench.run import run_clip

PROGRAM = "python -m research.bounds"
RULE, UNIFORM, FIRST = "accumulate/contrast", "accumulate", "oidn"
DENSITY_WINDOWS = (3, 7)  # pixels, side of the windows that errors are averaged over
BLEND_WINDOWS = (1, 7, 15, 31)
MORE_SAMPLES = (1.25, 1.5, 2.0)
ORDER, OTHER_ORDER = 0, 1  # seeds of the samples: those that are scored, and those of the errors
SMALL = 1e-12  # a squared difference below which two images are one


class Bound(NamedTuple):
    """PSNR of one replacement minus that of the rule on one clip, in dB."""

    clip: str
    spp: float
    part: str
    gain: float


@dataclass(frozen=True)
class InformedDensity(Accumulate):
    """The rule with a given error of each frame in place of the last image's contrast."""

    errors: Sequence[Tensor] = ()  # n 1 h w, squared, one for each frame

    def plan(self, gbuffer: GBuffer, samples: Samples, state: Memory) -> Float[Tensor, "n 1 h w"]:
        """The root of the error, mixed with uniform samples as the rule is."""
        error = self.errors[state.age].sqrt()
        return mix_with_uniform(error, torch.ones_like(error))


@dataclass(frozen=True)
class InformedBlend(Accumulate):
    """The rule with the weight of the last image that is best by the truth, window by window."""

    truths: Iterator[Tensor] = iter(())  # n 3 h w in log transfer, one for each frame
    side: int = 1  # of a window, pixels

    def blend_weight(
        self, denoised: Float[Tensor, "n 3 h w"], history: History
    ) -> Float[Tensor, "n 1 h w"]:
        """The least-squares weight in [0, 1]; 0 without history."""
        truth, change = next(self.truths), history.image - denoised
        product = box_mean((change * (truth - denoised)).sum(1, keepdim=True), self.side)
        square = box_mean(change.square().sum(1, keepdim=True), self.side)
        weight = (product / square.clamp_min(SMALL)).clamp(0, 1)
        return weight.where(history.similarity > 0, 0.0)


def measure_clip(folder: Path, spp: float) -> Iterator[Bound]:
    """The gain of each replacement on a clip, in dB, at a budget in samples per pixel."""
    device = torch.device("cpu")
    rule = registry.load_method(RULE, device)
    assert isinstance(rule, Accumulate)
    clip = open_clip(folder, rule.traits.inputs, seed=ORDER)
    base = _score(rule, clip, spp)

    def bound(part: str, scores: Sequence[float], frames: slice = slice(None)) -> Bound:
        gains = [a - b for a, b in zip(scores[frames], base[frames], strict=True)]
        return Bound(clip.name, spp, part, sum(gains) / len(gains))

    yield bound("uniform samples", _score(registry.load_method(UNIFORM, device), clip, spp))
    errors = _errors(rule, open_clip(folder, rule.traits.inputs, seed=OTHER_ORDER), spp)
    for side in DENSITY_WINDOWS:
        windows = [box_mean(error, side) for error in errors]
        informed = InformedDensity(**_parts(rule), errors=windows)
        yield bound(f"density by the true error, {side}x{side}", _score(informed, clip, spp))
    for side in BLEND_WINDOWS:
        truths = (log_forward(frame.reference.half_a) for frame in clip)
        blend = InformedBlend(**_parts(rule), truths=truths, side=side)
        yield bound(f"blend by the truth, {side}x{side}", _score(blend, clip, spp))
    for factor in MORE_SAMPLES:
        yield bound(f"{factor:g} times the samples", _score(rule, clip, factor * spp))
    if registry.get_variant(FIRST).traits.unsupported_reason(spp) is None:
        scores = _score(registry.load_method(FIRST, device), clip, spp)
        yield bound(f"first frame by {FIRST}", scores, slice(1))


def summarize(bounds: Sequence[Bound]) -> pd.DataFrame:
    """Mean gain over clips of each part, a column for each budget."""
    table = pd.DataFrame(bounds)
    order = list(dict.fromkeys(table["part"]))
    return table.pivot_table(index="part", columns="spp", values="gain").loc[order]


def _parts(method: Accumulate) -> Mapping[str, Any]:
    return {field.name: getattr(method, field.name) for field in fields(Accumulate)}


def _score(method: Method, clip: StoredClip, spp: float) -> list[float]:
    """PSNR in dB of each frame, in clipped sRGB, by the second half of the reference alone.

    The variance of that half, half the mean squared difference of both, is taken off the error.
    """
    mse = registry.load_plugin("metrics", "mse")

    def error(image: Tensor, reference: Tensor) -> float:
        return float(mse.score(mse.compare(image, reference, reference)))

    scores = []
    for result in run_clip(method, clip, spp):
        half_a, half_b = result.frame.reference.half_a, result.frame.reference.half_b
        squared = error(result.image, half_b) - error(half_a, half_b) / 2
        scores.append(-10 * math.log10(max(squared, SMALL)))
    return scores


def _errors(method: Method, clip: StoredClip, spp: float) -> list[Tensor]:
    """The squared error of each frame in log transfer by the first half of the reference."""
    return [
        (log_forward(result.image) - log_forward(result.frame.reference.half_a))
        .square()
        .mean(1, keepdim=True)
        for result in run_clip(method, clip, spp)
    ]


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Gains in dB over accumulate/contrast where one part knows the truth.",
        epilog=f"example:\n  {PROGRAM} ~/.cache/rlbench/clips/development/* --spp 0.5,1,4",
    )
    add_clips(parser)
    parser.add_argument("--out", type=Path, help="CSV file for the gains of every clip")
    arguments = parser.parse_args()
    cells = read_cells(parser, arguments)
    bounds = [bound for cell in track(cells, "measuring") for bound in measure_clip(*cell)]
    if arguments.out:
        pd.DataFrame(bounds).to_csv(arguments.out, index=False)
    print_gains("part", summarize(bounds))


if __name__ == "__main__":
    main()
