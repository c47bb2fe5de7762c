"""Where the time of a training goes: python -m rlbench.training.profiler ours --frames 60."""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import torch

from rlbench import registry
from rlbench.registry import discovery
from rlbench.training import dataset
from rlbench.training.batches import Batches, sample_budget
from rlbench.training.config import TrainingConfig
from rlbench.training.task import TrainingTask
from rlbench.training.train_state import TrainState

PARTS = {  # functions of the core, in the order in which they run
    ("batches.py", "draw"): "read and cut a draw",
    ("train_state.py", "_remember"): "keep what a replay needs",
    ("train_state.py", "_forward"): "forward, with the loss",
    ("losses.py", "mixed"): "of that, L1 and MS-SSIM",
    ("train_state.py", "_backward"): "backward",
    ("train_state.py", "_clip"): "clip the gradient",
    ("train_state.py", "_step"): "Adam",
    ("train_state.py", "_follow"): "average the weights",
}
OWN = 6  # functions of the method's own that are shown, the longest first


class Part(NamedTuple):
    """One function, with all that it calls."""

    told: str
    seconds: float


class Profile(NamedTuple):
    """What was measured."""

    frames: int
    seconds: float
    parts: tuple[Part, ...]

    def text(self) -> str:
        """A table in Markdown."""
        head = f"{self.frames} frames in {self.seconds:.1f} s, {self.frames / self.seconds:.2f}/s"
        lines = [head, "", "| part | share | ms a frame |", "| --- | ---: | ---: |"]
        for told, seconds in self.parts:
            each = 1e3 * seconds / self.frames
            lines.append(f"| {told} | {seconds / self.seconds:.1%} | {each:.1f} |")
        return "\n".join(lines)


def profile(
    name: str,
    folders: Sequence[Path],
    plan: TrainingConfig,
    device: str = "cpu",
    clock: Callable[[], float] = time.perf_counter,
) -> Profile:
    """Train `name` for `plan.frames` and say what each part of it took, one after the other.

    Nothing is read ahead, so that what reading takes is seen; each draw was read once before, as
    most draws of a long training were. On a GPU, where work is queued, parts wait for each other.
    """
    trainer: TrainingTask = registry.training_task(name, device, plan.seed)
    learner = TrainState(trainer, plan.norm, plan.average, plan.half, device)
    batches = Batches.planned(folders, plan, trainer.method.traits, device)
    learner.sequence(
        batches.sequence(0), trainer.spp[0], 1e-3, 0.0
    )  # what is compiled or planned once
    draws = range(-(-plan.frames // (plan.batch * plan.length)))
    for index in draws:
        batches.sequence(index)
    seen, watched = 0, cProfile.Profile(clock)
    for index in draws:
        spp = sample_budget(plan.spp or trainer.spp, plan.seed, index)
        watched.enable()
        clip = batches.sequence(index)
        learner.sequence(clip, spp, 1e-3, index / len(draws))
        watched.disable()
        seen += len(clip) * clip.size.n
    own = discovery.module_file(registry.family(name).train).parent
    return _read(pstats.Stats(watched), seen, own)


def _read(stats: pstats.Stats, frames: int, own: Path) -> Profile:
    """The parts of the core, then the longest functions of the method's own folder."""
    core: dict[str, Part] = {}
    theirs: list[Part] = []
    found: dict[tuple[str, int, str], tuple[int, int, float, float, object]] = stats.stats  # type: ignore[attr-defined]
    for (file, _, function), (_, _, _, seconds, _) in found.items():
        told = PARTS.get((Path(file).name, function))
        if told and Path(file).is_relative_to(Path(__file__).parents[1]):
            core[told] = Part(told, seconds)
        elif Path(file).parent == own:
            theirs.append(Part(f"`{Path(file).name}` {function}", seconds))
    longest = sorted(theirs, key=lambda part: -part.seconds)[:OWN]
    order = [core[told] for told in PARTS.values() if told in core]
    total: float = stats.total_tt  # type: ignore[attr-defined]
    return Profile(frames, total, (*order, *longest))


def main(words: Sequence[str] | None = None) -> str:
    """The table of what the command line asks for."""
    parser = argparse.ArgumentParser("python -m rlbench.training.profiler", description=__doc__)
    parser.add_argument("method")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--crop", type=int, default=128)
    parser.add_argument("--half", action="store_true", help="bfloat16 forward pass")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--busy", action="store_true", help="time of the processor, on one shared")
    parser.add_argument("--clips", type=Path, nargs="+", help="folders; default preset train's")
    asked = parser.parse_args(words)
    torch.set_num_threads(asked.threads)
    pool = registry.variant(asked.method).traits.pool
    folders = asked.clips or dataset.generated("train", kinds={pool}).train
    plan = TrainingConfig(frames=asked.frames, crop=asked.crop, half=asked.half)
    clock = time.process_time if asked.busy else time.perf_counter
    return profile(asked.method, folders, plan, asked.device, clock).text()


if __name__ == "__main__":
    import sys

    sys.stdout.write(main() + "\n")
