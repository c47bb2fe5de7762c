"""Train the sampler by every learner on toy scenes, and score it against the known optimum.

Command: python -m methods.ours.gradients.compare_learners --out docs. It resumes after an
interruption.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from itertools import product
from pathlib import Path

import torch
from rich.progress import Progress
from torch import nn

from methods.ours import LATENT
from methods.ours.gradients.command import Options, make_parser
from methods.ours.gradients.toy_evaluation import (
    TABLE,
    Evaluation,
    ToyEnv,
    Training,
    read_scores,
    write_csv,
)
from methods.ours.gradients.toy_problem import CHANNELS, MODES, Mode, ToyProblem, toy_frames
from methods.ours.networks import Sampler
from methods.ours.policy import (
    AllocationProblem,
    BlockPolicyGradient,
    BlockReinforce,
    CombinedLearner,
    SamplerLearner,
    StochasticLearner,
    appo,
    make_learner,
)
from rlbench.ops.init import kaiming_init

PROGRAM = "python -m methods.ours.gradients.compare_learners"
MAX_LR, FINAL_SHARE = 2e-3, 0.1  # learning rate at the start, and its share at the end; linear
BATCH = 4  # frames of a step; with one, gradients are so noisy that the map's contrast swings
POINTS = 8  # scores during a training
SEED_STRIDE = 10**9  # between the seeds of sampler, critic and actions: separate random streams

OnScore = Callable[[int, float, float], None]  # frames, seconds of CPU, score


class TrueGradient(SamplerLearner):
    """The upper bound: the gradient of the expected error, which is unknown in practice."""

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> torch.Tensor:
        """The exact expected error of the relaxed counts."""
        assert isinstance(problem, ToyProblem)
        return problem.expected_error(problem.relaxed_counts(problem.act())).mean()


def blocks_of_reach(mode: Mode) -> int:
    """Side of a block as large as the reach of a sample, pixels."""
    return max(1, 2 * mode.reach)


def reinforce(mode: Mode, price_weight: float = 1.0, block: int | None = None) -> BlockReinforce:
    """REINFORCE whose margin is the reach of the mode, and whose blocks are as large."""
    side = block or blocks_of_reach(mode)
    policy = BlockPolicyGradient(block=side, margin=mode.reach, price_weight=price_weight)
    return BlockReinforce(policy)


def stochastic(mode: Mode, block: int | None = None) -> StochasticLearner:
    """Differences over the next sample, with the margin and blocks of `reinforce`."""
    return StochasticLearner(block or blocks_of_reach(mode), mode.reach)


TORCH: Mapping[str, Callable[[Mode], SamplerLearner]] = {
    "true gradient": lambda mode: TrueGradient(),
    "reinforce": reinforce,
    "reinforce+surrogate": lambda mode: CombinedLearner(reinforce(mode)),
    "critic": lambda mode: make_learner("critic", CHANNELS),
    "surrogate": lambda mode: make_learner("surrogate", CHANNELS),
    "gamma": lambda mode: make_learner("gamma", CHANNELS),
    "stochastic": stochastic,
    "reinforce, no price": partial(reinforce, price_weight=0.0),
    "reinforce, single pixels": partial(reinforce, block=1),
    "stochastic, single pixels": partial(stochastic, block=1),
}
RLLIB: Mapping[str, Callable[[Mode], appo.AppoSettings]] = {
    "rllib-appo": lambda mode: appo.AppoSettings(reach=mode.reach),
    "rllib-appo, joint ratio": lambda mode: appo.AppoSettings(joint_ratio=True),
}


def initial_sampler(seed: int) -> Sampler:
    """The sampler of `ours`, with seeded weights and a uniform density."""
    sampler = Sampler(CHANNELS, LATENT.sampler)
    kaiming_init(sampler, seed)
    sampler.start_uniform()
    return sampler


def train_by_learner(
    name: str, evaluation: Evaluation, seed: int, frames: int, on_score: OnScore
) -> None:
    """One training, with a step for every BATCH frames."""
    mode, sampler, learner = evaluation.mode, initial_sampler(seed), TORCH[name](evaluation.mode)
    parts = nn.ModuleList(part for part in (sampler, learner.network) if part is not None)
    optimizer = torch.optim.Adam(parts.parameters(), MAX_LR)
    generator = torch.Generator().manual_seed(seed + 2 * SEED_STRIDE)
    if learner.network is not None:
        kaiming_init(learner.network, seed + SEED_STRIDE)
    seconds, interval = 0.0, max(frames // POINTS, BATCH)
    stream = toy_frames(seed, BATCH, evaluation.side)
    for done, frame in zip(range(BATCH, frames + 1, BATCH), stream, strict=False):
        began = time.process_time()
        for group in optimizer.param_groups:
            group["lr"] = MAX_LR * (1 - (1 - FINAL_SHARE) * done / frames)
        problem = ToyProblem(frame, mode, sampler, min_samples=learner.min_samples)
        loss = learner.loss(problem, generator)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        seconds += time.process_time() - began
        if done % interval < BATCH:
            on_score(done, seconds, evaluation.score(sampler, learner.min_samples))


def train_by_rllib(
    name: str, evaluation: Evaluation, seed: int, frames: int, on_score: OnScore
) -> None:
    """One training in RLlib's loop; seconds are those of this process, without Ray's start."""
    began: list[float] = []
    scoring = 0.0  # seconds

    def report(done: int, sampler: nn.Module) -> None:
        nonlocal scoring
        now = time.process_time()
        on_score(done, now - began[0] - scoring, evaluation.score(sampler, 0))
        scoring += time.process_time() - now

    def make_env() -> ToyEnv:
        began.append(time.process_time())
        return ToyEnv(evaluation.mode, seed, evaluation.side)

    settings, interval = RLLIB[name](evaluation.mode), frames // POINTS
    appo.train(make_env, lambda: initial_sampler(seed), frames, settings, seed, interval, report)


def compare(
    file: Path, frames: int, side: int, seeds: list[int], names: list[str], modes: list[str]
) -> None:
    """Run the trainings that the table `file` lacks, and add their scores.

    Raises ValueError if the table has trainings of another length, or on frames of another size.
    """
    scores = read_scores(file, frames, side)
    trainings = [Training(name, mode, seed) for seed, mode, name in product(seeds, modes, names)]
    missing = [training for training in trainings if training not in scores]
    needed = {training.mode for training in missing}
    evaluations = {mode: Evaluation.of_mode(MODES[mode], side=side) for mode in needed}
    with Progress() as progress:
        bar = progress.add_task("trainings", total=len(missing) * frames)
        for number, training in enumerate(missing):
            start, rows = number * frames, scores.setdefault(training, [])
            progress.update(bar, description=str(training), completed=start)

            def on_score(done: int, seconds: float, score: float) -> None:
                row = {**training._asdict(), "side": side, "of": frames, "frames": done}  # noqa: B023
                row |= {"seconds": f"{seconds:.1f}", "score": f"{score:.4f}"}
                rows.append({key: str(value) for key, value in row.items()})  # noqa: B023
                progress.update(bar, completed=start + done)  # noqa: B023

            train = train_by_learner if training.learner in TORCH else train_by_rllib
            train(training.learner, evaluations[training.mode], training.seed, frames, on_score)
            write_csv(file, [row for training_rows in scores.values() for row in training_rows])


DESCRIPTION = f"""Train the sampler of `ours` by every learner on a problem whose optimal allocation
is known. Write the share of the optimal error reduction that each reaches to OUT/{TABLE}.
Trainings that are in the table are not run again.
Then draw the figure: python -m research.reports.known_optimum OUT"""
EXAMPLES = (
    "--out docs",
    '--out /tmp/try --frames 500 --seeds 0 --learners "surrogate;reinforce"',
)
OPTIONS: Options = {
    "--out": (Path("docs"), "folder of the table"),
    "--frames": (1600, "frames of each training"),
    "--side": (32, "side of a frame, a multiple of 8 pixels"),
    "--seeds": ("0,1,2", "seeds of weights, scenes and actions"),
    "--learners": (";".join([*TORCH, *RLLIB]), 'separated by ";"'),
    "--modes": (",".join(MODES), "of the problem"),
}


def main() -> None:
    """Run the command line."""
    parser = make_parser(PROGRAM, DESCRIPTION, EXAMPLES, OPTIONS)
    arguments = parser.parse_args()
    names, modes = arguments.learners.split(";"), arguments.modes.split(",")
    options = (("--learners", names, [*TORCH, *RLLIB]), ("--modes", modes, list(MODES)))
    for option, requested, known in options:
        for name in requested:
            if name not in known:
                parser.error(f"{option}: '{name}' is unknown. Choose from: {', '.join(known)}")
    if arguments.frames < POINTS * BATCH:
        parser.error(f"--frames {arguments.frames}: give {POINTS * BATCH} or more")
    if arguments.side % 8:
        parser.error(f"--side {arguments.side}: give a multiple of 8")
    torch.set_num_threads(1)
    seeds = [int(seed) for seed in arguments.seeds.split(",")]
    try:
        compare(arguments.out / TABLE, arguments.frames, arguments.side, seeds, names, modes)
    except ValueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
