"""Measure every gradient estimator against the exact gradient, and where ratios saturate.

Command: python -m methods.ours.gradients.measure --out docs/results

The clipped objective of PPO and APPO ignores an action whose importance ratio has left 1 ± clip in
the direction of its advantage. A ratio over all pixels is a product of as many factors, so the same
step of the weights moves it further on a larger image.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import torch
from jaxtyping import Float
from rich.progress import track
from torch import Tensor
from torch.nn import functional as F

from methods.ours.gradients.command import make_parser
from methods.ours.gradients.compare_learners import initial_sampler
from methods.ours.gradients.estimators import ESTIMATORS, Measurement, measure
from methods.ours.gradients.exact_gradient import BUDGETS, DENOISERS
from methods.ours.gradients.toy_evaluation import write_csv
from methods.ours.gradients.toy_problem import Direct, ToyProblem, toy_frames
from methods.ours.policy import BlockPolicyGradient, BlockReinforce
from methods.ours.policy.appo import AppoSettings
from methods.ours.policy.joint_appo import joint_ratio, pixel_ratios

PROGRAM = "python -m methods.ours.gradients.measure"
GRADIENTS, RATIOS = "gradients.csv", "importance_ratio.csv"
EXPLORED_DRAWS = 32  # of the slow reference, whose draws have little noise
SIDES = (8, 16, 32, 64, 128, 256)  # rows and columns of the image
BLOCK = 8  # rows and columns of a block of the block ratio, the default of BlockPolicyGradient
MEAN_STEP = 1e-3  # of every pixel's mean action
RATIO_KINDS = ("joint", "block", "pixel")
CHUNK = 16  # actions at a time


@dataclass(frozen=True)
class Saturation:
    """Share of ratios outside the clip range after one step."""

    ratio: str  # one of RATIO_KINDS
    step: str  # "mean + 0.001" or "Adam 0.001"
    side: int  # pixels
    rms_change: float  # root mean square over pixels of the change of the mean action
    clipped: float  # share in [0, 1]


def measure_saturation(side: int, draws: int = 256, seeds: int = 3) -> Iterator[Saturation]:
    """The share of clipped ratios on images of one size, for both steps and all ratios.

    The first step moves the mean action of every pixel by 0.001. The second is the first step of
    Adam for the sampler of `ours` on the policy gradient of a toy scene: it moves every weight by
    the learning rate of AppoSettings, 0.001; results are means over `seeds` samplers and scenes.
    APPO repeats batches, so its policies are further apart.
    """
    settings = AppoSettings()
    rate, spread, clip = settings.learning_rate, settings.action_std, settings.clip
    steps = {
        f"mean + {MEAN_STEP:g}": [torch.full((side, side), MEAN_STEP)],
        f"Adam {rate:g}": [adam_step(side, rate, seed) for seed in range(seeds)],
    }
    for step, changes in steps.items():
        shares = [clipped_shares(change, spread, clip, draws) for change in changes]
        rms = [float(change.square().mean().sqrt()) for change in changes]
        for ratio in RATIO_KINDS:
            share = statistics.fmean(s[ratio] for s in shares)
            yield Saturation(ratio, step, side, statistics.fmean(rms), share)


def adam_step(side: int, learning_rate: float, seed: int = 0) -> Float[Tensor, "h w"]:
    """Change of the mean action by the first Adam step of an untrained sampler.

    The first step moves each weight by the learning rate against the sign of its gradient.
    """
    sampler = initial_sampler(seed)
    problem = ToyProblem(next(toy_frames(seed, 1, side)), Direct(), sampler)
    learner = BlockReinforce(BlockPolicyGradient(block=1, margin=0))
    weights = list(sampler.parameters())
    loss = learner.loss(problem, torch.Generator().manual_seed(seed))
    gradients = torch.autograd.grad(loss, weights)
    with torch.no_grad():
        before = problem.act()
        for weight, gradient in zip(weights, gradients, strict=True):
            weight.sub_(learning_rate * gradient.sign())
        return (problem.act() - before)[0, 0]


def clipped_shares(
    change: Float[Tensor, "h w"], action_std: float, clip: float, draws: int, seed: int = 0
) -> dict[str, float]:
    """Share of ratios outside 1 ± clip, by ratio, when each mean action changes by `change`.

    Actions are drawn by the previous policy: one per pixel for the joint and the pixel ratio, one
    per block of 8 x 8 pixels for the block ratio.
    """
    generator = torch.Generator().manual_seed(seed)
    outside: dict[str, list[Tensor]] = {ratio: [] for ratio in RATIO_KINDS}
    blocks = F.avg_pool2d(change[None, None], BLOCK).flatten()
    for _ in range(0, draws, CHUNK):
        pixels = action_std * torch.randn(CHUNK, change.numel(), generator=generator)
        coarse = action_std * torch.randn(CHUNK, blocks.numel(), generator=generator)
        ratios = {
            "joint": joint_ratio(change.flatten(), torch.zeros(()), pixels, action_std),
            "block": pixel_ratios(blocks, torch.zeros(()), coarse, action_std),
            "pixel": pixel_ratios(change.flatten(), torch.zeros(()), pixels, action_std),
        }
        for name, values in ratios.items():
            outside[name].append(((values - 1).abs() > clip).float().mean(-1, keepdim=True))
    return {name: float(torch.cat([v.flatten() for v in s]).mean()) for name, s in outside.items()}


def gradient_row(measurement: Measurement) -> dict[str, str]:
    """One row of the table of gradients; the direction is empty where noise hides it."""
    statistics = measurement.statistics
    row = {
        "estimator": measurement.estimator,
        "denoiser": measurement.denoiser,
        "spp": f"{measurement.spp:g}",
        "draws": str(measurement.draws),
        "has_scale": str(ESTIMATORS[measurement.estimator].has_scale),
    }
    for name in ("scale", "cosine", "bias"):
        interval = getattr(statistics, name)
        is_known = name == "scale" or statistics.is_resolved
        row[name] = f"{interval.value:.4g}" if is_known else ""
        row[f"{name}_margin"] = f"{interval.margin:.2g}" if is_known else ""
    return row | {"noise": f"{statistics.noise:.4g}", "frames": f"{statistics.frames_needed:.4g}"}


def write_tables(
    folder: Path, draws: int, budgets: Sequence[float] = BUDGETS, sides: Sequence[int] = SIDES
) -> None:
    """Measure, and write both tables to `folder`."""
    cells = list(product(ESTIMATORS, DENOISERS, budgets))
    rows = [
        gradient_row(measure(name, denoiser, spp, _number_of_draws(name, draws)))
        for name, denoiser, spp in track(cells, "gradients")
    ]
    write_csv(folder / GRADIENTS, rows)
    write_csv(folder / RATIOS, list(_ratio_rows(sides)))


def _number_of_draws(name: str, draws: int) -> int:
    return min(draws, EXPLORED_DRAWS) if name.endswith("truth") else draws


def _ratio_rows(sides: Sequence[int]) -> Iterator[Mapping[str, str]]:
    for side in sides:
        for saturation in measure_saturation(side):
            row = asdict(saturation)
            yield {key: f"{v:.4g}" if isinstance(v, float) else str(v) for key, v in row.items()}


def main() -> None:
    """Run the command line."""
    parser = make_parser(
        PROGRAM,
        "Compare the gradient estimators that train a sampler with the exact gradient of a toy\n"
        f"problem, and write OUT/{GRADIENTS}. Count the importance ratios that one step moves\n"
        f"out of the clip range, and write OUT/{RATIOS}.\n"
        "Then draw the figures: python -m research.reports.gradients OUT",
        ("--out docs/results", "--out /tmp/try --draws 64"),
        {
            "--out": (Path("docs/results"), "folder"),
            "--draws": (512, "gradients per measurement"),
        },
    )
    arguments = parser.parse_args()
    if arguments.draws < 2:
        parser.error(f"--draws {arguments.draws}: give 2 or more")
    torch.set_num_threads(1)
    write_tables(arguments.out, arguments.draws)


if __name__ == "__main__":
    main()
