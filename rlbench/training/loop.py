"""The training loop: the same for every learned method, so that only the methods differ."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from rlbench import registry
from rlbench.clips.in_memory import InMemoryClip
from rlbench.system.memory import keep_freed_memory
from rlbench.training import checkpoint, replay, validation
from rlbench.training.batches import Batches, prefetch, sample_budget
from rlbench.training.config import TrainingConfig
from rlbench.training.logger import TrainingLogger
from rlbench.training.progress import Progress, describe_changes
from rlbench.training.task import TrainingError, TrainingTask
from rlbench.training.train_state import NonFiniteStepError, TrainState
from rlbench.training.trained_weights import frames_in_weights, save_weights, weights_path

__all__ = ["TrainingResult", "check_budgets", "train"]

CHECKPOINT = "checkpoint.safetensors"


class TrainingResult(NamedTuple):
    """What a training run produced."""

    weights: Path  # safetensors file, with its model card beside it
    progress: Progress


def train(
    method: str,
    train_clips: Sequence[Path],
    validation_clips: Sequence[Path],
    out: Path,
    config: TrainingConfig,
    device: str = "cpu",
    minutes: float = math.inf,
    command: str = "",
    on_progress: Callable[[Progress, float], None] = lambda progress, loss: None,
    allow_config_change: bool = False,
    remark: str = "",
) -> TrainingResult:
    """Train a method on clip folders, and write its weights and model card to `out`.

    While it runs, `out` gets checkpoint.safetensors, log.jsonl and, if TensorBoard is installed,
    its event files; after `config.frames` frames, or after `minutes`, NAME.safetensors and its
    card NAME.toml. `command` and `remark` are recorded in the card; `on_progress` is called with
    progress and loss after each sequence.

    A finished run is left unchanged. An interrupted run resumes from its last checkpoint; on a CPU
    the final weights are bit-identical to those of an uninterrupted run. A checkpoint with a
    different config or different clips is refused, unless `allow_config_change`; the card then
    records what changed, and when.

    Raises PluginError if the method has nothing to train, BatchError if no crops can be cut from
    the clips, and TrainingError if the method does not support a budget, if the checkpoint has a
    different config, or if a loss or a gradient is not finite. In the last case the sequence is
    stored in a file for `replay_sequence`.
    """
    check_budgets(method, config)
    keep_freed_memory()
    task: TrainingTask = registry.training_task(method, device, config.seed)
    state = TrainState(task, config, device)
    batches = Batches.from_config(train_clips, config, task.method.traits, device)
    requested = {"method": method, **config.to_dict(), "data": batches.clip_digests()}
    progress = _start_or_resume(state, out / CHECKPOINT, requested, allow_config_change)
    result = TrainingResult(weights_path(method, out), progress)
    if config.frames <= progress.frames_seen == frames_in_weights(result.weights):
        return result
    spp = validation.validation_budgets(task.method, task.spp, config.spp)
    began = time.monotonic() - progress.seconds
    stop = time.monotonic() + 60 * minutes
    with prefetch(batches) as sequence, closing(TrainingLogger(out, progress.frames_seen)) as log:
        while progress.frames_seen < config.frames and time.monotonic() < stop:
            intervals, started = progress.frames_seen // config.eval_interval, time.monotonic()
            learning_rate = task.max_lr * config.lr_factor(progress.frames_seen)
            clip = sequence(progress.sequences)
            loss = _train_sequence(method, state, clip, progress, out)
            progress.seconds = time.monotonic() - began
            progress.frames_per_second = _count_frames(clip) / max(time.monotonic() - started, 1e-9)
            log.log_sequence(progress, loss, learning_rate)
            finished = progress.frames_seen >= config.frames
            if finished or progress.frames_seen // config.eval_interval > intervals:
                networks = (task.method, state.networks, state.ema_networks)
                score = validation.validate(*networks, validation_clips, spp, device)
                progress.validation_history.append((progress.frames_seen, score.psnr))
                log.log_validation(progress, loss, score)
                checkpoint.write(out / CHECKPOINT, state.state_dict(), asdict(progress))
            on_progress(progress, loss)
    checkpoint.write(out / CHECKPOINT, state.state_dict(), asdict(progress))
    save_weights(method, result.weights, state, progress, command, remark)
    return result


def check_budgets(method: str, config: TrainingConfig) -> None:
    """Raise TrainingError if a method cannot be trained at a budget of the config."""
    traits = registry.get_variant(method).traits
    for spp in config.spp:
        if reason := traits.unsupported_reason(spp):
            raise TrainingError(f"'{method}' cannot be trained at {spp:g} spp: {reason}")


def _start_or_resume(
    state: TrainState, file: Path, requested: dict[str, Any], allow_config_change: bool
) -> Progress:
    """The progress of the checkpoint, whose tensors are loaded; or of a new run without one."""
    if not file.exists():
        return Progress(config=requested)
    metadata, tensors = checkpoint.read(file)
    progress = Progress.from_dict(metadata)
    trained = progress.config.setdefault("method", requested["method"])  # absent in old checkpoints
    if trained != requested["method"]:
        raise TrainingError(
            f"{file} belongs to method '{trained}', but '{requested['method']}' was requested. "
            "Choose another --out"
        )
    changes = describe_changes(progress.config, requested)
    if changes and not allow_config_change:
        raise TrainingError(
            f"{file} was written with a different config (changed: {'; '.join(changes)}). Repeat "
            "the options, choose another --out, or pass --allow-config-change to resume anyway"
        )
    progress.switch_config(requested)
    state.load_state_dict(tensors, progress.steps)
    return progress


def _train_sequence(
    method: str, state: TrainState, clip: InMemoryClip, progress: Progress, out: Path
) -> float:
    """Train on the next sequence and advance the progress; returns the mean loss."""
    config, index = state.config, progress.sequences
    spp = sample_budget(config.spp or state.task.spp, config.seed, index)
    lr_factor = config.lr_factor(progress.frames_seen)
    fraction = progress.frames_seen / config.frames
    try:
        loss = state.train_sequence(clip, spp, lr_factor, fraction)
    except NonFiniteStepError as error:
        failed = replay.FailedSequence(method, clip, index, spp, lr_factor, fraction)
        file = replay.write(out, state, failed, error.failure)
        raise TrainingError(
            f"Training of '{method}' stopped in sequence {index} at {spp:g} spp: {error}. The "
            f"sequence is stored in {file}; 'rlbench replay {file}' repeats it. To resume "
            "from the last checkpoint with a different config, pass --allow-config-change, for "
            "example with --max-grad-norm 0.1"
        ) from error
    progress.frames_seen += _count_frames(clip)
    progress.sequences += 1
    progress.steps = state.steps
    return loss


def _count_frames(clip: InMemoryClip) -> int:
    """Crops in a batch: each frame of each clip counts."""
    return len(clip) * clip.size.n
