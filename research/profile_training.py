"""Profile of a training run, part by part: python -m research.profile_training ours --frames 60."""

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
from rlbench.training.batches import Batches, sequence_budget
from rlbench.training.task import TrainingConfig, TrainingTask
from rlbench.training.train_state import TrainState

PARTS = {  # functions of rlbench, in the order in which they run
    ("batches.py", "sequence"): "read and crop a sequence",
    ("train_state.py", "_forward"): "forward, with the loss",
    ("losses.py", "l1_ms_ssim_loss"): "of that, L1 and MS-SSIM",
    ("train_state.py", "_backward"): "backward",
    ("optimizer_step.py", "_clip_gradients"): "clip the gradient",
    ("optimizer_step.py", "_move_weights"): "Adam",
    ("optimizer_step.py", "_update_average"): "average the weights",
}
METHOD_FUNCTIONS = 6  # how many functions of the method's own package are listed
WARM_UP_LR_FACTOR = 1e-3


class ProfiledPart(NamedTuple):
    """One function, including everything that it calls."""

    label: str
    seconds: float


class TrainingProfile(NamedTuple):
    """How long a number of frames took, and each part of it."""

    frames: int
    seconds: float
    parts: tuple[ProfiledPart, ...]

    def to_markdown(self) -> str:
        """A table with the share and the milliseconds per frame of each part."""
        rate = self.frames / self.seconds
        head = f"{self.frames} frames in {self.seconds:.1f} s, {rate:.2f} frames/s"
        lines = [head, "", "| part | share | ms per frame |", "| --- | ---: | ---: |"]
        for label, seconds in self.parts:
            frame_ms = 1e3 * seconds / self.frames
            lines.append(f"| {label} | {seconds / self.seconds:.1%} | {frame_ms:.1f} |")
        return "\n".join(lines)


def profile(
    method: str,
    clips: Sequence[Path],
    config: TrainingConfig,
    device: str = "cpu",
    clock: Callable[[], float] = time.perf_counter,
) -> TrainingProfile:
    """Train a method for `config.frames` and measure each part, one after the other.

    Sequences are not prefetched, so that reading is measured too; each was read once before, as
    most sequences of a long run were. On a GPU, work is queued, so parts wait for each other.
    """
    task: TrainingTask = registry.training_task(method, device, config.seed)
    state = TrainState(task, config, device)
    batches = Batches.from_config(clips, config, task.method.traits, device)
    # once without measuring: compilation and other work of the first sequence
    state.train_sequence(batches.sequence(0), task.spp[0], WARM_UP_LR_FACTOR, 0.0)
    indices = range(-(-config.frames // (config.batch * config.sequence_length)))
    for index in indices:
        batches.sequence(index)
    frames, profiler = 0, cProfile.Profile(clock)
    for index in indices:
        profiler.enable()
        clip = batches.sequence(index)
        spp = sequence_budget(clip, config.spp or task.spp, config.seed, index)
        state.train_sequence(clip, spp, WARM_UP_LR_FACTOR, index / len(indices))
        profiler.disable()
        frames += len(clip) * clip.size.n
    method_folder = discovery.module_file(registry.load_family(method).train).parent
    return _summarize(pstats.Stats(profiler), frames, method_folder)


def _summarize(stats: pstats.Stats, frames: int, method_folder: Path) -> TrainingProfile:
    """The parts in PARTS, then the longest functions in the method's own folder."""
    core: dict[str, ProfiledPart] = {}
    own: list[ProfiledPart] = []
    functions: dict[tuple[str, int, str], tuple[int, int, float, float, object]] = stats.stats  # type: ignore[attr-defined]
    for (file, _, function), (_, _, _, seconds, _) in functions.items():
        label = PARTS.get((Path(file).name, function))
        if label and Path(file).is_relative_to(Path(__file__).parents[1]):
            core[label] = ProfiledPart(label, seconds)
        elif Path(file).parent == method_folder:
            own.append(ProfiledPart(f"`{Path(file).name}` {function}", seconds))
    longest = sorted(own, key=lambda part: -part.seconds)[:METHOD_FUNCTIONS]
    ordered = [core[label] for label in PARTS.values() if label in core]
    total: float = stats.total_tt  # type: ignore[attr-defined]
    return TrainingProfile(frames, total, (*ordered, *longest))


def main(argv: Sequence[str] | None = None) -> str:
    """The table for the given command-line arguments."""
    parser = argparse.ArgumentParser("python -m research.profile_training", description=__doc__)
    parser.add_argument("method")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--crop", type=int, default=128)
    parser.add_argument("--bf16", "--half", action="store_true", help="bfloat16 forward pass")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument(
        "--cpu-time", "--busy", action="store_true", help="CPU time, for a shared machine"
    )
    parser.add_argument(
        "--clips", type=Path, nargs="+", help="clip folders; default: those of preset train"
    )
    options = parser.parse_args(argv)
    torch.set_num_threads(options.threads)
    pool = registry.get_variant(options.method).traits.pool
    clips = options.clips or dataset.select_split(None, None, None, {pool}).train
    config = TrainingConfig(frames=options.frames, crop=options.crop, bf16=options.bf16)
    clock = time.process_time if options.cpu_time else time.perf_counter
    return profile(options.method, clips, config, options.device, clock).to_markdown()


if __name__ == "__main__":
    import sys

    sys.stdout.write(main() + "\n")
