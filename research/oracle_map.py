"""Oracle density maps: an estimate of the most that any map of samples gains on one frame.

Command: python -m research.oracle_map --spp 1,2,4

The map of one frame is optimised on the frame's own error, behind the trained encoder and denoiser
and with the history of the frames before it. No sampler has this knowledge. The map has one value a
block, so it cannot select single samples, and every step takes the stored samples in another order.
Scores are of orders that no step has used.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from rich.console import Console
from rich.progress import track
from torch import Tensor, nn
from torch.nn import functional as F

from methods.ours.gradients.command import Options, make_parser
from methods.ours.history import RecurrentState
from methods.ours.method import Ours, build
from methods.ours.policy import BlockReinforce
from methods.ours.problem import FrameProblem
from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.frames import Frame
from rlbench.system import paths

PROGRAM = "python -m research.oracle_map"
BLOCK = 8  # pixels, side of a block
LEARNING_RATE = 0.05  # of Adam, on values whose tanh is the action
MAX_START = 0.95  # of the initial action's size; beyond, tanh is flat
TRAIN_ORDERS, TEST_ORDERS = 8, 4  # sample orders of the steps, and of the scores


class OracleResult(NamedTuple):
    """PSNR of one frame in dB, mean over sample orders that no step has used."""

    clip: str
    spp: float
    frame: int
    uniform: float
    learned: float  # the sampler's map
    best: float  # the map optimised for this frame


@dataclass(frozen=True)
class FreeDensityMap(FrameProblem):
    """A FrameProblem whose action is a free map in place of the sampler's."""

    values: Tensor  # n 1 h/BLOCK w/BLOCK; their tanh is the action

    def act(self) -> Float[Tensor, "n 1 h w"]:
        """The map's action."""
        h, w = self.frame.pool.size[1:]
        return F.interpolate(self.values.tanh(), scale_factor=BLOCK)[..., :h, :w]


def score_frame(method: Ours, folder: Path, spp: float, index: int, steps: int) -> OracleResult:
    """Scores of uniform samples, the sampler's map and the best map on frame `index` of a clip.

    Raises ValueError if the clip has no such frame.
    """
    orders = range(TRAIN_ORDERS + TEST_ORDERS)
    sequences = [list(_frames(method, folder, seed, index)) for seed in orders]
    if (last := sequences[0][-1].index) != index:
        raise ValueError(f"--frame {index}: {folder} has frames 0 to {last}. Choose one of these")
    state = _state_before_last(method, sequences[0], spp)
    problems = [FrameProblem.of_frame(method, frames[-1], state, spp) for frames in sequences]
    with torch.no_grad():
        learned = problems[0].act()
    best = optimize_map(problems[:TRAIN_ORDERS], learned, steps)
    maps = (torch.zeros_like(learned), learned, best)
    scores = [_psnr(problems[TRAIN_ORDERS:], action) for action in maps]
    return OracleResult(folder.name, spp, index, *scores)


def optimize_map(
    problems: Sequence[FrameProblem], action: Float[Tensor, "n 1 h w"], steps: int
) -> Float[Tensor, "n 1 h w"]:
    """An action optimised from `action` on these problems, which share one frame.

    Each of the `steps` takes the next problem in turn.
    """
    start = F.avg_pool2d(action, BLOCK, ceil_mode=True).clamp(-MAX_START, MAX_START)
    values = nn.Parameter(start.atanh())
    optimizer = torch.optim.Adam([values], LEARNING_RATE)
    learner, generator = BlockReinforce(), torch.Generator().manual_seed(0)
    for step in range(steps):
        optimizer.param_groups[0]["lr"] = LEARNING_RATE * (1 - step / steps)
        optimizer.zero_grad()
        problem = _with_map(problems[step % len(problems)], values)
        learner.loss(problem, generator).backward()  # type: ignore[no-untyped-call]
        optimizer.step()
    return _with_map(problems[0], values.detach()).act()


def _with_map(problem: FrameProblem, values: Tensor) -> FreeDensityMap:
    return FreeDensityMap(
        problem.method, problem.frame, problem.gbuffer, problem.state, problem.spp, values
    )


def _frames(method: Ours, folder: Path, seed: int, last: int) -> Iterator[Frame]:
    clip = open_clip(folder, method.traits.inputs, pool=method.traits.pool, seed=seed)
    for frame in clip:
        yield frame
        if frame.index == last:
            return


@torch.no_grad()
def _state_before_last(method: Ours, frames: Sequence[Frame], spp: float) -> RecurrentState:
    """The state after all frames but the last, sampled by the sampler's mean action."""
    state = method.start(frames[0].pool.size)
    for frame in frames[:-1]:
        problem = FrameProblem.of_frame(method, frame, state, spp)
        state = problem.step(problem.act()).state
    return state


def _psnr(problems: Sequence[FrameProblem], action: Float[Tensor, "n 1 h w"]) -> float:
    psnr = registry.load_plugin("metrics", "psnr")
    results = [(problem.render(action), problem.frame.reference) for problem in problems]
    frames = [psnr.compare(image, truth.half_a, truth.half_b) for image, truth in results]
    scores = [float(psnr.score(frame)) for frame in frames]
    return sum(scores) / len(scores)


DESCRIPTION = """Optimise the density map of one frame of each clip on the frame's own error.
Compare it with uniform samples and with the sampler's map, on other samples."""
EXAMPLES = ("", "--spp 1,2 --steps 100 --out /tmp/oracle.csv")
OPTIONS: Options = {
    "--spp": ("1,2,4", "samples per pixel"),
    "--frame": (5, "index of the frame, counted from 0"),
    "--steps": (200, "optimiser steps of four actions each"),
    "--out": (Path("ceiling.csv"), "CSV file to append to"),
}


def main() -> None:
    """Run the command line."""
    options = {**OPTIONS, "--clips": (paths.clips_folder() / "mini", "folder of clips")}
    parser = make_parser(PROGRAM, DESCRIPTION, EXAMPLES, options)
    arguments = parser.parse_args()
    folders = sorted(file.parent for file in arguments.clips.glob("*/clip.toml"))
    if not folders:
        parser.error(
            f"--clips {arguments.clips}: the folder has no clips. Render some with 'rlbench "
            "render', or choose another folder"
        )
    method = build("", torch.device("cpu"), None)
    cells = [(folder, float(spp)) for folder in folders for spp in arguments.spp.split(",")]
    for folder, spp in track(cells, "optimising"):
        try:
            result = score_frame(method, folder, spp, arguments.frame, arguments.steps)
        except ValueError as error:
            parser.error(str(error))
        _append(arguments.out, result)


def _append(file: Path, result: OracleResult) -> None:
    """Append a result to a CSV file, with a header if the file is new, and print it."""
    is_new = not file.exists()
    with file.open("a", newline="") as out:
        table = csv.writer(out)
        if is_new:
            table.writerow(OracleResult._fields)
        table.writerow(result)
    values = result._asdict().items()
    Console().print(*(f"{k} {v:.2f}" if isinstance(v, float) else f"{v}" for k, v in values))


if __name__ == "__main__":
    main()
