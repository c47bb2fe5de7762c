"""How much could any map of samples give? The best one found for a frame by itself.

Command: python -m methods.ours.experiments.oracle_map --spp 1,2,4

Behind the trained encoder and denoiser, and with what was remembered, the map of one frame is
improved on its own error: what no sampler knows before it has sampled. The map has one value a
block, so that it cannot pick single samples, and every step sells them in another order. Scores are
of orders that no step has seen.
"""

from __future__ import annotations

import argparse
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

from methods.ours.frame_problem import FrameProblem
from methods.ours.method import Ours, build
from methods.ours.policy.block_reinforce import BlockReinforce
from methods.ours.state import RecurrentState
from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.frames import Frame
from rlbench.system import paths

BLOCK = 8  # pixels: side of what has one value
RATE = 0.05  # of Adam, on values of which tanh is the action
BOUND = 0.95  # of actions at the start, beyond which tanh is flat
SEEN, HELD = 8, 4  # orders of sale: of the steps, and of the scores


class Found(NamedTuple):
    """PSNR of one frame in dB, mean over orders of sale that no step has seen."""

    clip: str
    spp: float
    frame: int
    uniform: float
    learned: float
    best: float  # of the map found for this frame


@dataclass(frozen=True)
class FreeDensityMap(FrameProblem):
    """A turn whose action is a map of its own in place of the sampler's."""

    values: Tensor  # n 1 h/BLOCK w/BLOCK; tanh of them is the action

    def act(self) -> Float[Tensor, "n 1 h w"]:
        """The map's action."""
        h, w = self.frame.pool.size[1:]
        return F.interpolate(self.values.tanh(), scale_factor=BLOCK)[..., :h, :w]


def ceiling(method: Ours, folder: Path, spp: float, index: int, steps: int) -> Found:
    """What uniform samples, the sampler, and the best map found give on frame `index` of a clip.

    Raises ValueError where the clip has no such frame.
    """
    orders = [list(_frames(method, folder, seed, index)) for seed in range(SEEN + HELD)]
    if (last := orders[0][-1].index) != index:
        raise ValueError(f"frame {index} asked for, {folder} has 0 to {last}")
    state = _remembered(method, orders[0], spp)
    turns = [_turn(method, frames[-1], state, spp) for frames in orders]
    with torch.no_grad():
        learned = turns[0].act()
    best = improved(turns[:SEEN], learned, steps)
    maps = (torch.zeros_like(learned), learned, best)
    return Found(folder.name, spp, index, *(_psnr(turns[SEEN:], each) for each in maps))


def improved(
    turns: Sequence[FrameProblem], action: Float[Tensor, "n 1 h w"], steps: int
) -> Float[Tensor, "n 1 h w"]:
    """An action that is better on these turns of one frame, by so many steps of its own."""
    whole = F.avg_pool2d(action, BLOCK, ceil_mode=True).clamp(-BOUND, BOUND)
    values = nn.Parameter(whole.atanh())
    optimizer = torch.optim.Adam([values], RATE)
    learns, generator = BlockReinforce(), torch.Generator().manual_seed(0)
    for step in range(steps):
        optimizer.param_groups[0]["lr"] = RATE * (1 - step / steps)
        optimizer.zero_grad()
        turn = _free(turns[step % len(turns)], values)
        learns.loss(turn, generator).backward()  # type: ignore[no-untyped-call]
        optimizer.step()
    return _free(turns[0], values.detach()).act()


def _free(turn: FrameProblem, values: Tensor) -> FreeDensityMap:
    return FreeDensityMap(turn.method, turn.frame, turn.gbuffer, turn.state, turn.spp, values)


def _frames(method: Ours, folder: Path, seed: int, last: int) -> Iterator[Frame]:
    clip = open_clip(folder, method.traits.inputs, pool=method.traits.pool, seed=seed)
    for frame in clip:
        yield frame
        if frame.index == last:
            return


@torch.no_grad()
def _remembered(method: Ours, frames: Sequence[Frame], spp: float) -> RecurrentState:
    """What is left of all frames but the last, sampled as the sampler wishes."""
    h, w = frames[0].pool.size[1:]
    state = method.start(frames[0].pool.size)
    for frame in frames[:-1]:
        turn = _turn(method, frame, state, spp)
        state = turn.take(turn.act())[2]
    return state


def _turn(method: Ours, frame: Frame, state: RecurrentState, spp: float) -> FrameProblem:
    return FrameProblem(method, frame, frame.gbuffer.select(method.traits.inputs), state, spp)


def _psnr(turns: Sequence[FrameProblem], action: Float[Tensor, "n 1 h w"]) -> float:
    score = registry.load("metrics", "psnr").score
    shown = [(turn.show(action)[0], turn.frame.reference) for turn in turns]
    return sum(float(score(image, truth.half_a, truth.half_b)) for image, truth in shown) / len(
        shown
    )


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m methods.ours.experiments.oracle_map",
        description="Improve the map of one frame of each clip on its own error, and score it on "
        "other samples, beside uniform samples and the sampler's own map.",
        epilog="example: python -m methods.ours.experiments.oracle_map "
        "--spp 1,2 --steps 100 --out /tmp/c.csv",
    )
    parser.add_argument("--clips", type=Path, default=paths.clips() / "mini", help="folder of them")
    parser.add_argument("--spp", default="1,2,4", help="samples per pixel")
    parser.add_argument(
        "--frame", type=int, default=5, help="which, from 0; those before lead there"
    )
    parser.add_argument("--steps", type=int, default=200, help="of four trials each")
    parser.add_argument("--out", type=Path, default=Path("ceiling.csv"), help="a table, added to")
    given = parser.parse_args()
    folders = sorted(file.parent for file in given.clips.glob("*/clip.toml"))
    if not folders:
        parser.error(
            f"{given.clips} holds no clip: 'rlbench render' makes some, --clips takes others"
        )
    method = build("", torch.device("cpu"), None)
    cells = [(folder, float(spp)) for folder in folders for spp in given.spp.split(",")]
    for folder, spp in track(cells, "improving"):
        try:
            _add(given.out, ceiling(method, folder, spp, given.frame, given.steps))
        except ValueError as error:
            parser.error(str(error))


def _add(file: Path, found: Found) -> None:
    begun = file.exists()
    with file.open("a", newline="") as out:
        table = csv.writer(out)
        if not begun:
            table.writerow(Found._fields)
        table.writerow(found)
    told = (f"{k} {v:.2f}" if isinstance(v, float) else f"{v}" for k, v in found._asdict().items())
    Console().print(*told)


if __name__ == "__main__":
    main()
