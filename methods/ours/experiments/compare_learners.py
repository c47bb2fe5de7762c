"""Who finds a known optimum? Every way to train the sampler, on the same frames, at one command.

Command: python -m methods.ours.experiments.compare_learners --out docs; goes on where it was
stopped.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path

import torch
from rich.progress import Progress
from torch import nn

from methods.ours.experiments.evaluation import Evaluation, Scenes
from methods.ours.experiments.known_optimum import MODES, Mode, ToyProblem
from methods.ours.experiments.toy_scenes import CHANNELS, scenes
from methods.ours.networks import Sampler
from methods.ours.policy import (
    AllocationProblem,
    BlockPolicyGradient,
    CombinedLearner,
    SamplerLearner,
    appo,
    appo_config,
    learner,
)
from methods.ours.policy.block_reinforce import BlockReinforce
from methods.ours.variants import BASE
from rlbench.ops.init import kaiming_init
from rlbench.system import paths

PEAK, FALL = 2e-3, 0.1  # learning rate at the start, and of it at the end: a line between
SCENES = 4  # frames of a step: of one, gradients are so noisy that the map's contrast swings
POINTS = 8  # scores along a training
APART = 10**9  # between the seeds of a sampler, a critic and draws, which are streams of their own
COLUMNS = ("learner", "mode", "seed", "side", "of", "frames", "seconds", "score")  # of: in all
TABLE = "known_optimum.csv"

Tell = Callable[[int, float, float], None]  # frames, seconds of CPU, score


class Truth:
    """The upper reference: the gradient of the expected error, which nobody has in practice."""

    floor = 0
    network = None

    def loss(self, situation: AllocationProblem, generator: torch.Generator) -> torch.Tensor:
        """The exact expected error of the relaxed counts."""
        assert isinstance(situation, ToyProblem)
        return situation.expected(situation.relaxed(situation.act())).mean()


def ppo(priced: float = 1.0, block: int | None = None) -> Callable[[Mode], BlockReinforce]:
    """Errors are credited as far as the mode spreads them, and draws are as large."""

    def made(mode: Mode) -> BlockReinforce:
        side = block or max(1, 2 * mode.reach)
        return BlockReinforce(
            BlockPolicyGradient(block=side, margin=mode.reach, price_weight=priced)
        )

    return made


TORCH: dict[str, Callable[[Mode], SamplerLearner]] = {
    "true gradient": lambda mode: Truth(),
    "ppo-pixel": ppo(),
    "ppo-pixel+surrogate": lambda mode: CombinedLearner(ppo()(mode)),
    "critic": lambda mode: learner("critic", CHANNELS),
    "surrogate": lambda mode: learner("surrogate", CHANNELS),
    "gamma": lambda mode: learner("gamma", CHANNELS),
    "ppo-pixel, no price": ppo(priced=0.0),
    "ppo-pixel, single pixels": ppo(block=1),
}
RLLIB: dict[str, Callable[[Mode], appo_config.Appo]] = {
    "rllib-appo": lambda mode: appo_config.Appo(reach=mode.reach),
    "rllib-appo, joint ratio": lambda mode: appo_config.Appo(joint=True),
}


def network(seed: int) -> Sampler:
    """The sampler of `ours`, with seeded weights and a uniform density."""
    made = Sampler(CHANNELS, BASE.sampler)
    kaiming_init(made, seed)
    made.start_uniform()
    return made


def by_torch(name: str, exam: Evaluation, seed: int, frames: int, tell: Tell) -> None:
    """One training; a step for every SCENES frames."""
    mode, sampler, way = exam.mode, network(seed), TORCH[name](exam.mode)
    trained = nn.ModuleList(part for part in (sampler, way.network) if part is not None)
    optimizer = torch.optim.Adam(trained.parameters(), PEAK)
    generator = torch.Generator().manual_seed(seed + 2 * APART)
    if way.network is not None:
        kaiming_init(way.network, seed + APART)
    seconds, every = 0.0, max(frames // POINTS, SCENES)
    stream = scenes(seed, SCENES, exam.side)
    for seen, field in zip(range(SCENES, frames + 1, SCENES), stream, strict=False):
        began = time.process_time()
        for group in optimizer.param_groups:
            group["lr"] = PEAK * (1 - (1 - FALL) * seen / frames)
        loss = way.loss(ToyProblem(field, mode, sampler, floor=way.floor), generator)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        seconds += time.process_time() - began
        if seen % every < SCENES:
            tell(seen, seconds, exam.score(sampler, way.floor))


def by_rllib(name: str, exam: Evaluation, seed: int, frames: int, tell: Tell) -> None:
    """One training in Ray's own loop; seconds are those of this process, without its start."""
    began: list[float] = []
    away = 0.0  # seconds spent on scores

    def report(seen: int, sampler: nn.Module) -> None:
        nonlocal away
        now = time.process_time()
        tell(seen, now - began[0] - away, exam.score(sampler, 0))
        away += time.process_time() - now

    def world() -> Scenes:
        began.append(time.process_time())
        return Scenes(exam.mode, seed, exam.side)

    settings, every = RLLIB[name](exam.mode), frames // POINTS
    appo.train(world, lambda: network(seed), frames, settings, seed, every, report)


def compare(
    table: Path, frames: int, side: int, seeds: list[int], names: list[str], modes: list[str]
) -> None:
    """Fill the table with what it lacks; a training that is in it is not run again.

    Raises ValueError where it holds trainings of another length, or on frames of another size.
    """
    table.parent.mkdir(parents=True, exist_ok=True)
    rows = _read(table)
    asked = (str(side), str(frames))
    if other := {(row["side"], row["of"]) for row in rows} - {asked}:
        known = " and ".join(f"--frames {of} --side {pixels}" for pixels, of in sorted(other))
        raise ValueError(
            f"{table} holds trainings by {known}, asked for is --frames {frames} --side {side}, "
            "and they cannot be compared; give another --out"
        )
    wanted = [(name, mode, seed) for seed in seeds for mode in modes for name in names]
    done = {(row["learner"], row["mode"], int(row["seed"])) for row in rows}
    todo = [cell for cell in wanted if cell not in done]
    exams = {mode: Evaluation.of(MODES[mode], side=side) for mode in {cell[1] for cell in todo}}
    with Progress() as progress:
        task = progress.add_task("trainings", total=len(todo) * frames)
        for at, (name, mode, seed) in enumerate(todo):
            progress.update(task, description=f"{name}, {mode}, seed {seed}", completed=at * frames)
            fresh: list[dict[str, str]] = []

            def tell(seen: int, seconds: float, score: float) -> None:
                told = (seen, f"{seconds:.1f}", f"{score:.4f}")
                values = (name, mode, seed, *asked, *told)  # noqa: B023
                fresh.append(dict(zip(COLUMNS, map(str, values), strict=True)))  # noqa: B023
                progress.update(task, completed=at * frames + seen)  # noqa: B023

            run = by_torch if name in TORCH else by_rllib
            run(name, exams[mode], seed, frames, tell)
            rows += fresh
            _write(table, rows)


def _read(table: Path) -> list[dict[str, str]]:
    if not table.exists():
        return []
    with table.open(newline="") as file:
        return list(csv.DictReader(file))


def _write(table: Path, rows: list[dict[str, str]]) -> None:
    with paths.replacing(table) as part, part.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m methods.ours.experiments.compare_learners",
        description="Train the sampler of `ours` in every way on a problem whose best allocation "
        "is known, and write the share of the optimal error reduction that each reaches to "
        f"OUT/{TABLE}. Goes on where it was stopped. The figure: python -m reports.known_optimum.",
        epilog="example: python -m methods.ours.experiments.compare_learners "
        "--out /tmp/try --frames 500 --seeds 0 "
        '--learners "surrogate;ppo-pixel"',
    )
    every = [*TORCH, *RLLIB]
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder of the table")
    parser.add_argument("--frames", type=int, default=1600, help="that each training sees")
    parser.add_argument("--side", type=int, default=32, help="of a frame, pixels; divides by 8")
    parser.add_argument("--seeds", default="0,1,2", help="of weights, scenes and draws")
    parser.add_argument("--learners", default=";".join(every), help="some of these, between ;")
    parser.add_argument("--modes", default=",".join(MODES), help="some of these")
    asked = parser.parse_args()
    names, modes = asked.learners.split(";"), asked.modes.split(",")
    for kind, given, known in (("learner", names, every), ("mode", modes, list(MODES))):
        for name in given:
            if name not in known:
                parser.error(f"'{name}' is no {kind}; there is: {', '.join(known)}")
    if asked.frames < POINTS * SCENES or asked.side % 8:
        parser.error(
            f"--frames {asked.frames} --side {asked.side}: it takes {POINTS * SCENES} frames or "
            "more, and a side that divides by 8"
        )
    torch.set_num_threads(1)
    seeds = [int(seed) for seed in asked.seeds.split(",")]
    try:
        compare(asked.out / TABLE, asked.frames, asked.side, seeds, names, modes)
    except ValueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
