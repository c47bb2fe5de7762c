"""Training: what is equal for every method that learns, so that only the method differs."""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from rlbench import checkpoint, provenance, registry, weights
from rlbench.batches import Batches
from rlbench.clips import open_clip
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.run import run_clip

WARM_UP = 0.15  # share of the training in which the learning rate rises
START, END = 1 / 25, 1e-4  # learning rate at the first and at the last step, of the peak
SETTLED = 0.1  # dB: a validation curve that rose by less between its last two points is flat


class TrainingError(RuntimeError):
    """A training that cannot start or go on."""


@dataclass(frozen=True)
class Trainer:
    """What is trained: made by the function that a family's `train` names."""

    method: Method  # unrolled with gradients; state must be detached where `losses` yields
    networks: nn.Module  # what is trained and saved
    losses: Callable[[Clip, float], Iterator[Tensor]]  # one optimiser step for each that it yields
    spp: tuple[float, ...]  # budgets, one drawn for each sequence
    peak: float = 5e-4  # highest learning rate of Adam, by a range test of this architecture
    shares: Mapping[str, float] = field(default_factory=dict)  # of it, by child of `networks`
    told: Callable[[float], None] = lambda done: None  # before each sequence, share of frames seen


@dataclass(frozen=True)
class Plan:
    """How long and on what; equal for all methods that are to be compared."""

    frames: int = 12_000  # crops to see, each frame of each clip in a batch counts
    batch: int = 1  # crops advanced together; on few frames, more steps are worth more
    crop: int = 128  # side of a crop, pixels
    length: int = 6  # frames of a sequence
    average: float = 0.998  # decay of the averaged weights, which are the ones shipped
    seed: int = 0
    norm: float = 1.0  # gradients are clipped to this length
    half: bool = False  # bfloat16 autocast of the forward pass
    every: int = 1_000  # frames between validations and checkpoints

    def rate(self, seen: int) -> float:
        """One-cycle learning rate after `seen` frames, as a share of the peak.

        It rises by a cosine, then falls by one.

        Smith and Topin 2018, as in torch's OneCycleLR with pct_start 0.15, div_factor 25,
        final_div_factor 400 (that is 1e4 / 25 from the start).
        """
        share = min(seen / self.frames, 1.0)
        if share < WARM_UP:
            low, high, along = START, 1.0, share / WARM_UP
        else:
            low, high, along = END, 1.0, 1 - (share - WARM_UP) / (1 - WARM_UP)
        return low + (high - low) * (1 - math.cos(math.pi * along)) / 2


@dataclass
class Progress:
    """Where a training stands; all that a resumed one needs beside the tensors."""

    seen: int = 0  # frames
    draws: int = 0  # sequences
    steps: int = 0
    seconds: float = 0.0
    curve: list[tuple[int, float]] = field(default_factory=list)  # frames, validation PSNR
    plan: dict[str, Any] = field(default_factory=dict)  # that it follows

    def note(self, frames: int) -> str:
        """What whoever uses the weights should know: was it cut short of `frames`, or too short?"""
        if self.seen < frames:
            return f"stopped at {self.seen} of {frames} frames"
        if len(self.curve) < 2:
            return ""
        (before, low), (_, high) = self.curve[-2:]
        if high - low < SETTLED:
            return ""
        return f"not yet flat: validation rose by {high - low:.2f} dB after {before} frames"


def train(
    name: str,
    train_on: Sequence[Path],
    validate_on: Sequence[Path],
    out: Path,
    plan: Plan,
    device: str = "cpu",
    minutes: float = math.inf,
    command: str = "",
    report: Callable[[Progress, float], None] = lambda progress, loss: None,
) -> Progress:
    """Train method `name`, resuming what lies in `out`; writes weights and card when it is done.

    `out` gets checkpoint.safetensors and log.jsonl while it runs, and NAME.safetensors with its
    card NAME.toml at the end, or when `minutes` are over. A training that is done is left as it is.
    Raises PluginError where there is nothing to train, TrainingError where a loss is not finite or
    where the plan or the clips are others than those of the checkpoint.
    """
    trainer: Trainer = registry.trainer(name, device, plan.seed)
    trainer.networks.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    pool = trainer.method.traits.pool
    batches = Batches(train_on, plan.batch, plan.crop, plan.length, plan.seed, device, pool)
    average = copy.deepcopy(trainer.networks)
    optimizer = torch.optim.Adam(_groups(trainer), trainer.peak)
    opened = [open_clip(folder, pool=pool) for folder in train_on]
    data = [f"{clip.name} {clip.digest[:12]}" for clip in opened]
    asked = {**asdict(plan), "data": data}
    progress, kept = Progress(plan=asked), out / "checkpoint.safetensors"
    if kept.exists():
        progress = Progress(**checkpoint.load(kept, trainer.networks, average, optimizer))
        if progress.plan != asked:
            raise TrainingError(
                f"{kept} was trained by another plan: {progress.plan}, asked for {asked}; "
                "ask for the same, or train into another folder"
            )
        if progress.seen >= plan.frames and _weights(name, out).exists():
            return progress
    began, before = time.monotonic(), progress.seconds
    while progress.seen < plan.frames and time.monotonic() - began < 60 * minutes:
        due = progress.seen // plan.every
        loss = _sequence(trainer, batches, optimizer, average, plan, progress)
        progress.seconds = before + time.monotonic() - began
        report(progress, loss)
        if progress.seen // plan.every > due or progress.seen >= plan.frames:
            progress.curve.append((progress.seen, _validate(trainer, average, validate_on, device)))
            _log(out / "log.jsonl", progress, loss)
            checkpoint.save(kept, trainer.networks, average, optimizer, asdict(progress))
    checkpoint.save(kept, trainer.networks, average, optimizer, asdict(progress))
    _ship(name, out, average, trainer.peak, plan, progress, device, command)
    return progress


def _groups(trainer: Trainer) -> list[dict[str, Any]]:
    """The parameters of each child network, and its share of the learning rate."""
    children = trainer.networks.named_children()
    pairs = [(list(child.parameters()), trainer.shares.get(name, 1.0)) for name, child in children]
    return [{"params": parameters, "share": share} for parameters, share in pairs if parameters]


def _sequence(
    trainer: Trainer,
    batches: Batches,
    optimizer: torch.optim.Optimizer,
    average: nn.Module,
    plan: Plan,
    progress: Progress,
) -> float:
    """Train on the next draw; returns its mean loss."""
    clip = batches.draw(progress.draws)
    generator = torch.Generator().manual_seed(plan.seed * 7_919 + progress.draws)
    spp = trainer.spp[int(torch.randint(len(trainer.spp), (), generator=generator))]
    trainer.networks.train()
    trainer.told(progress.seen / plan.frames)
    losses = trainer.losses(clip, spp)
    total, count = 0.0, 0
    while True:
        with torch.autocast(torch.device(batches.device).type, torch.bfloat16, enabled=plan.half):
            loss = next(losses, None)
        if loss is None:
            break
        if not torch.isfinite(loss):
            raise TrainingError(f"loss is {float(loss)} in draw {progress.draws} at {spp:g} spp")
        for group in optimizer.param_groups:
            group["lr"] = trainer.peak * group["share"] * plan.rate(progress.seen)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(trainer.networks.parameters(), plan.norm)
        optimizer.step()
        _follow(
            average,
            trainer.networks,
            min(plan.average, (1 + progress.steps) / (10 + progress.steps)),
        )
        progress.steps += 1
        total, count = total + loss.item(), count + 1
    progress.seen += len(clip) * clip.size.n
    progress.draws += 1
    return total / max(count, 1)


@torch.no_grad()
def _follow(average: nn.Module, networks: nn.Module, keep: float) -> None:
    for slow, fast in zip(
        average.state_dict().values(), networks.state_dict().values(), strict=True
    ):
        slow.lerp_(fast, 1 - keep)


def _validate(trainer: Trainer, average: nn.Module, folders: Sequence[Path], device: str) -> float:
    """Mean PSNR of the averaged weights at each whole budget of 1 and 4 spp, all frames."""
    psnr = registry.load("metrics", "psnr").score
    trained = copy.deepcopy(trainer.networks.state_dict())
    trainer.networks.load_state_dict(average.state_dict())
    trainer.networks.eval()
    scores: list[float] = []
    for folder in folders:
        for spp in (1.0, 4.0):
            traits = trainer.method.traits
            clip = open_clip(folder, traits.needs, pool=traits.pool, device=device)
            for shown in run_clip(trainer.method, clip, spp):
                reference = shown.frame.reference
                scores += psnr(shown.image, reference.a, reference.b).tolist()
    trainer.networks.load_state_dict(trained)
    return sum(scores) / max(len(scores), 1)


def _log(path: Path, progress: Progress, loss: float) -> None:
    line: dict[str, Any] = {"seen": progress.seen, "loss": loss, "seconds": progress.seconds}
    line["psnr"] = progress.curve[-1][1]
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        file.write(json.dumps(line) + "\n")


def _device(device: str) -> str:
    machine = provenance.machine()
    cpu = f"{machine.cpu}, {torch.get_num_threads()} threads"
    return cpu if torch.device(device).type == "cpu" else machine.gpu


def _ship(
    name: str,
    out: Path,
    average: nn.Module,
    peak: float,
    plan: Plan,
    progress: Progress,
    device: str,
    command: str,
) -> None:
    card = weights.Card(
        name=name,
        data=tuple(progress.plan["data"]),
        frames_seen=progress.seen,
        steps=progress.steps,
        seconds=round(progress.seconds),
        device=_device(device),
        seed=plan.seed,
        command=command,
        commit=provenance.commit(),
        plan=json.dumps({**asdict(plan), "peak": peak}),
        curve=tuple(progress.curve),
        note=progress.note(plan.frames),
    )
    weights.save(average, _weights(name, out), card)


def _weights(name: str, out: Path) -> Path:
    family, _, variant = name.partition("/")
    return out / f"{variant or family}.safetensors"
