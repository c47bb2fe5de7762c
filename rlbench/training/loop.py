"""Training: what is equal for every method that learns, so that only the method differs."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from rlbench import registry, weights
from rlbench.clips.in_memory import InMemoryClip
from rlbench.method import config_json
from rlbench.system import provenance
from rlbench.training import checkpoint, logger, validation
from rlbench.training import replay as postmortem
from rlbench.training.batches import Batches, prefetch, sample_budget
from rlbench.training.config import TrainingConfig
from rlbench.training.progress import Progress
from rlbench.training.replay import replay
from rlbench.training.task import TrainingError, TrainingTask
from rlbench.training.train_state import NotFiniteError, TrainState

__all__ = [
    "TrainingConfig",
    "Progress",
    "TrainingTask",
    "TrainingError",
    "check",
    "replay",
    "shipped",
    "train",
]

CHECKPOINT = "checkpoint.safetensors"


def train(
    name: str,
    train_on: Sequence[Path],
    validate_on: Sequence[Path],
    out: Path,
    plan: TrainingConfig,
    device: str = "cpu",
    minutes: float = math.inf,
    command: str = "",
    report: Callable[[Progress, float], None] = lambda progress, loss: None,
    altered: bool = False,
) -> Progress:
    """Train method `name`, resuming what lies in `out`; writes weights and card when it is done.

    `out` gets checkpoint.safetensors, log.jsonl and, where it is installed, curves for TensorBoard
    while it runs, and NAME.safetensors with its card NAME.toml at the end, or when `minutes` are
    over. A training that is done is left as it is. One that was killed goes on from its last
    checkpoint, with weights that on a CPU are bit by bit those of one that was not. A checkpoint of
    another plan is refused, or gone on from where `altered`; the card then says what was changed,
    and when.
    Raises PluginError where there is nothing to train, and TrainingError where the method cannot
    take a budget, where plan or clips are others than those of the checkpoint, and where a loss or
    a gradient is not finite: the sequence is then kept in a file, for `replay`.
    """
    check(name, plan)
    trainer: TrainingTask = registry.training_task(name, device, plan.seed)
    learner = TrainState(trainer, plan.norm, plan.average, plan.half, device)
    traits = trainer.method.traits
    batches = Batches.planned(train_on, plan, traits, device)
    budgets = validation.budgets(trainer.method, trainer.spp, plan.spp)
    progress = _begin(learner, out, _asked(name, plan, batches.contents()), altered)
    if progress.seen >= plan.frames and _frames_shipped(name, out) == progress.seen:
        return progress
    began, before = time.monotonic(), progress.seconds
    with prefetch(batches) as draw, logger.told(out, progress.seen) as told:
        while progress.seen < plan.frames and time.monotonic() - began < 60 * minutes:
            due, started = progress.seen // plan.every, time.monotonic()
            rate = plan.lr_factor(progress.seen)
            loss, frames = _sequence(name, learner, draw(progress.draws), plan, progress, out)
            progress.seconds = before + time.monotonic() - began
            progress.speed = frames / max(time.monotonic() - started, 1e-9)
            told.sequence(progress, loss, trainer.max_lr * rate)
            if progress.seen // plan.every > due or progress.seen >= plan.frames:
                given = (trainer.method, learner.networks, learner.average)
                found = validation.validate(*given, validate_on, budgets, device)
                progress.curve.append((progress.seen, found.psnr))
                told.validated(progress, loss, found)
                _keep(learner, out, progress)
            report(progress, loss)
    _keep(learner, out, progress)
    _ship(name, out, learner, plan, progress, device, command)
    return progress


def check(name: str, plan: TrainingConfig) -> None:
    """Raise TrainingError where method `name` cannot be trained at a budget of the plan."""
    traits = registry.variant(name).traits
    for spp in plan.spp:
        if why := traits.unsupported_reason(spp):
            raise TrainingError(f"'{name}' cannot be trained at {spp:g} spp: {why}")


def shipped(name: str, out: Path) -> Path:
    """The weights file that a training of `name` into `out` ends with."""
    family, _, variant = name.partition("/")
    return out / f"{variant or family}.safetensors"


def _frames_shipped(name: str, out: Path) -> int | None:
    """The frames that whole weights in `out` have seen; a kill may leave others, or a part."""
    file = shipped(name, out)
    try:
        card = weights.read_card(file)
    except weights.WeightsError:
        return None
    return card.frames_seen if weights.digest(file) == card.sha256 else None


def _asked(name: str, plan: TrainingConfig, data: list[str]) -> dict[str, Any]:
    return {"method": name, **plan.told(), "data": data}


def _begin(learner: TrainState, out: Path, asked: dict[str, Any], altered: bool) -> Progress:
    """Where the training stands: at the start, or where its checkpoint was."""
    kept, trainer = out / CHECKPOINT, learner.trainer
    if not kept.exists():
        return Progress(plan=asked)
    progress = Progress(**checkpoint.read_metadata(kept))
    whose = progress.plan.setdefault("method", asked["method"])  # older checkpoints do not say
    if whose != asked["method"]:
        raise TrainingError(
            f"{kept} is of '{whose}', asked for is '{asked['method']}'; train into another folder"
        )
    if progress.plan != asked and not altered:
        raise TrainingError(
            f"{kept} was trained by another plan: {progress.plan}, asked for {asked}; "
            "ask for the same, train into another folder, or go on all the same with --altered"
        )
    progress.switch_config(asked)
    checkpoint.load(kept, learner.networks, learner.average, learner.optimizer, trainer.aside)
    learner.steps = progress.steps
    return progress


def _sequence(
    name: str,
    learner: TrainState,
    clip: InMemoryClip,
    plan: TrainingConfig,
    progress: Progress,
    out: Path,
) -> tuple[float, int]:
    """Learn from the next draw; returns its mean loss and its number of frames."""
    spp = sample_budget(plan.spp or learner.trainer.spp, plan.seed, progress.draws)
    rate, done = plan.lr_factor(progress.seen), progress.seen / plan.frames
    try:
        loss = learner.sequence(clip, spp, rate, done)
    except NotFiniteError as error:
        halted = postmortem.FailedSequence(name, clip, progress.draws, spp, rate, done)
        file = postmortem.write(out, learner, plan, halted, error.found)
        raise TrainingError(
            f"'{name}' halted in draw {progress.draws} at {spp:g} spp: {error}; the sequence is in "
            f"{file}, 'rlbench train --replay {file}' takes it again; the last checkpoint stands: "
            "--altered goes on from it by another plan, such as --norm 0.1"
        ) from error
    frames = len(clip) * clip.size.n
    progress.seen += frames
    progress.draws += 1
    progress.steps = learner.steps
    return loss, frames


def _keep(learner: TrainState, out: Path, progress: Progress) -> None:
    parts = (learner.networks, learner.average, learner.optimizer)
    checkpoint.save(out / CHECKPOINT, *parts, asdict(progress), learner.trainer.aside)


def _device(device: str) -> str:
    machine = provenance.machine()
    cpu = f"{machine.cpu}, {torch.get_num_threads()} threads"
    return cpu if torch.device(device).type == "cpu" else machine.gpu


def _ship(
    name: str,
    out: Path,
    learner: TrainState,
    plan: TrainingConfig,
    progress: Progress,
    device: str,
    command: str,
) -> None:
    trainer = learner.trainer
    budgets = {"spp": plan.spp or trainer.spp, "peak": trainer.max_lr}
    card = weights.ModelCard(
        name=name,
        data=tuple(progress.plan["data"]),
        frames_seen=progress.seen,
        steps=progress.steps,
        seconds=round(progress.seconds),
        device=_device(device),
        seed=plan.seed,
        command=command,
        commit=provenance.commit(),
        training_config=json.dumps({**plan.told(), **budgets}),
        method_config=config_json(trainer.method),
        origin=trainer.origin,
        validation_history=tuple(progress.curve),
        note=progress.note(plan.frames),
    )
    weights.save(learner.average, shipped(name, out), card)
