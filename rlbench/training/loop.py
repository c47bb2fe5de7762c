"""The training loop: the same for every learned method, so that only the methods differ.

`train` trains one method, `TrainingRuns` several with one config, each in a folder of its own.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch

from rlbench import registry
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.stored import open_clip
from rlbench.ops.recording import CudaGraphs
from rlbench.system.folder_lock import locked_folder
from rlbench.system.process_settings import keep_freed_memory, postpone_end
from rlbench.training import checkpoint, dataset
from rlbench.training.batches import Batches, prefetch, sequence_budget
from rlbench.training.checkpoint import (
    Progress,
    combine_digests,
    describe_changes,
    frames_in_weights,
    save_weights,
    start_from,
)
from rlbench.training.dataset import TrainingSplit
from rlbench.training.optimizer_step import NonFiniteStepError
from rlbench.training.render_ahead import FurtherClips, renew
from rlbench.training.run_folder import CHECKPOINT, TrainingLogger, run_folder, weights_path
from rlbench.training.task import TrainingConfig, TrainingError, TrainingTask
from rlbench.training.train_state import TrainState, ValidationResult

_logger = logging.getLogger(__name__)

STATUS_SECONDS = 10.0  # between two writings of the status

OnProgress = Callable[[Progress, float], None]  # progress and loss, after each sequence
# (title, total frames) -> a context in which the returned callback shows the progress
ProgressBar = Callable[[str, int], AbstractContextManager[OnProgress]]


class TrainingResult(NamedTuple):
    """What a training run produced."""

    weights: Path  # safetensors file, with its model card beside it
    progress: Progress


def train(
    method: str,
    train_clips: Sequence[Path],
    validation_clips: Sequence[Path] | Mapping[str, Sequence[Path]],
    out: Path,
    config: TrainingConfig,
    *,
    device: str = "cpu",
    graph: bool = False,
    minutes: float = math.inf,
    command: str = "",
    on_progress: OnProgress = lambda progress, loss: None,
    allow_config_change: bool = False,
    remark: str = "",
    mixed_in: Sequence[Path] = (),
    start: Path | None = None,
    further: FurtherClips | None = None,
) -> TrainingResult:
    """Train a method on clip folders, and write its weights and model card to `out`.

    `validation_clips` may be several sets by name, each with a curve of its own. The share
    `config.mix` of the crops is from `mixed_in`. `further` clips are rendered by a second process
    and replace the first of `train_clips`, one after the other. Budgets are limited to the stored
    samples of a clip; a warning and the card say for which clips. A new run starts from the tensors
    of the weights file `start` that fit; the card's `origin` names it.

    While it runs, `out` gets checkpoint.safetensors, log.jsonl, status.json and, if TensorBoard is
    installed, its event files; at the end of the config, or after `minutes`, NAME.safetensors
    and its card NAME.toml. `command` and `remark` are recorded in the card; `on_progress` is called
    with progress and loss after each sequence.

    With `graph`, each step is recorded as a CUDA graph, where the method's task allows it.
    With `config.until_flat` it goes on in cycles until one gains less than that. At SIGTERM it
    writes a checkpoint and ends the process.

    A finished run is left unchanged. An interrupted run resumes from its last checkpoint; on a CPU
    the final weights are bit-identical to those of an uninterrupted run. A checkpoint with a
    different config or different clips is refused, unless `allow_config_change`; the card then
    records what changed, and when.

    Raises PluginError if the method has nothing to train, BatchError if the method cannot use a
    clip or no crops can be cut from it, and TrainingError if the method does not support a budget,
    if there is no validation set to keep the best weights by, if the checkpoint has a different
    config, or if a loss or a gradient is not finite.
    """
    _check_budgets(method, config)
    sets = _name_sets(validation_clips, config)
    keep_freed_memory()
    task: TrainingTask = registry.training_task(method, device, config.seed)
    state = TrainState(
        task := start_from(task, start) if start else task,
        config,
        device,
        _select_recorder(device) if graph else None,
    )
    batches = Batches.from_config(train_clips, config, task.method.traits, device, mixed_in)
    _check_clips(method, [*train_clips, *mixed_in], sets, config.crop, config.spp or task.spp)
    limits = _describe_small_pools(method, batches, config.spp or task.spp)
    described = {name: _describe(clips, batches.pool) for name, clips in sets.items()}
    requested = {"method": method, **config.to_dict(), "data": batches.clip_digests()}
    chosen = {
        "validation": config.keeps_best and described,
        "start": start and task.origin,
        "render_ahead": further and f"{','.join(further.presets)} {further.count}",
    }
    requested |= {name: value for name, value in chosen.items() if value}
    progress = _start_or_resume(state, out / CHECKPOINT, requested, allow_config_change)
    result = TrainingResult(weights_path(method, out), progress)
    if progress.fraction_done >= 1 and progress.frames_seen == frames_in_weights(result.weights):
        return result
    began = time.monotonic() - progress.seconds
    stop, next_status, loss = time.monotonic() + 60 * minutes, 0.0, math.nan
    with (
        _advice_on_faults(method),
        renew(batches, further, config, out) as source,
        prefetch(source) as sequence,
        closing(TrainingLogger(out, progress.frames_seen)) as log,
        postpone_end() as is_to_end,
    ):
        while progress.fraction_done < 1 and time.monotonic() < stop and not is_to_end():
            intervals, started = progress.frames_seen // config.eval_interval, time.monotonic()
            learning_rate = task.max_lr * config.lr_factor(progress.cycle_done)
            clip = sequence(progress.sequences)
            loss = _train_sequence(state, clip, progress)
            progress.seconds = time.monotonic() - began
            progress.frames_per_second = _count_frames(clip) / max(time.monotonic() - started, 1e-9)
            log.log_sequence(progress, loss, learning_rate)
            is_due = progress.frames_seen // config.eval_interval > intervals
            if is_due or progress.fraction_done >= 1:
                log.log_validation(progress, loss, _validate(state, progress, sets))
                checkpoint.write(out / CHECKPOINT, state.state_dict(), asdict(progress))
                next_status = 0.0
            if time.monotonic() >= next_status:
                log.write_status(progress, loss)
                next_status = time.monotonic() + STATUS_SECONDS
            on_progress(progress, loss)
        log.write_status(progress, state.read_loss())
        checkpoint.write(out / CHECKPOINT, state.state_dict(), asdict(progress))
    note, drawn = "; ".join(filter(None, (remark, limits))), source.digests(progress.sequences)
    save_weights(method, result.weights, state, progress, command, note, described, drawn)
    return result


def _check_budgets(method: str, config: TrainingConfig) -> None:
    """Raise TrainingError if a method cannot be trained at a budget of the config."""
    traits = registry.get_variant(method).traits
    for spp in config.spp:
        if reason := traits.unsupported_reason(spp):
            raise TrainingError(f"'{method}' cannot be trained at {spp:g} spp: {reason}")


def _select_recorder(device: str) -> CudaGraphs:
    """What records steps. Raises TrainingError unless on a GPU."""
    if torch.device(device).type != "cuda":
        raise TrainingError(
            f"--graph records CUDA graphs, and cannot run on {device}; add --device cuda"
        )
    return CudaGraphs()


def _name_sets(
    clips: Sequence[Path] | Mapping[str, Sequence[Path]], config: TrainingConfig
) -> Mapping[str, Sequence[Path]]:
    """Validation sets by name; clips without a name are the set `validation`.

    Raises TrainingError if the weights that are best on a set are kept, and it has no clips, or if
    validations decide when to stop, and there are none.
    """
    sets = clips if isinstance(clips, Mapping) else {"validation": clips}
    word, _, name = config.keep.partition(":")
    known = [name for name, folders in sets.items() if folders]
    if config.keeps_best and (word != "best" or not known or name not in ("", *known)):
        raise TrainingError(
            f"cannot keep '{config.keep}': validation sets are {', '.join(known) or 'missing'}. "
            f"Choose {', '.join(['last', 'best', *(f'best:{each}' for each in known)])}"
        )
    if config.until_flat and not known:
        raise TrainingError("--until-flat compares validations, and there are no clips to validate")
    return sets


def _describe(clips: Sequence[Path], pool: str) -> str:
    """The number of clips and one digest of them all."""
    opened = [open_clip(folder, frozenset(), pool=pool) for folder in clips]
    digests = [f"{clip.name} {clip.digest[:12]}" for clip in opened]
    return f"{len(clips)} clips {combine_digests(digests)}"


def _check_clips(
    method: str,
    clips: Sequence[Path],
    sets: Mapping[str, Sequence[Path]],
    crop: int,
    budgets: Sequence[float],
) -> None:
    """Raise BatchError for a clip that the method cannot train or validate on."""
    traits = registry.get_variant(method).traits
    dataset.check_clips(method, traits, clips, crop, budgets)
    for folders in sets.values():
        dataset.check_clips(method, traits, folders, 0, budgets)


def _describe_small_pools(method: str, batches: Batches, budgets: Sequence[float]) -> str:
    """Which training clips limit the budgets, after a warning; empty if none does."""
    if limits := dataset.describe_small_pools(batches.stored_clips, budgets):
        _logger.warning("%s: %s", method, limits)
    return limits


def _validate(
    state: TrainState, progress: Progress, sets: Mapping[str, Sequence[Path]]
) -> ValidationResult:
    """Validate, append to the curves, and keep the averaged weights if they are the best so far.

    Where this ends a cycle, and the training is to go on, the next one begins.
    """
    config, frames, result = state.config, progress.frames_seen, state.validate(sets)
    progress.validation_history.append((frames, result.psnr))
    for name, score in result.sets.items():
        progress.curves.setdefault(name, []).append((frames, score.psnr, score.first_frames))
        progress.drift[name] = score.drift
    kept_set = config.keep.partition(":")[2]
    psnr = result.sets[kept_set].psnr if kept_set else result.psnr
    is_better = math.isfinite(psnr) and (progress.best is None or psnr > progress.best[1])
    if config.keeps_best and is_better:
        progress.best = (frames, psnr)
        state.keep_average()
    progress.begin_next_cycle()
    return result


def _start_or_resume(
    state: TrainState, file: Path, requested: dict[str, Any], allow_config_change: bool
) -> Progress:
    """The progress of the checkpoint, whose tensors are loaded; or of a new run without one."""
    if not file.exists():
        return Progress(config=requested)
    metadata, tensors = checkpoint.read(file)
    progress = Progress.from_dict(metadata)
    if (trained := progress.config.get("method")) != requested["method"]:
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


@contextmanager
def _advice_on_faults(method: str) -> Iterator[None]:
    """Raise TrainingError with advice in place of a NonFiniteStepError."""
    try:
        yield
    except NonFiniteStepError as error:
        raise TrainingError(
            f"Training of '{method}' stopped: {error}. To resume from the last checkpoint with a "
            "different config, pass --allow-config-change, for example with --max-grad-norm 0.1"
        ) from error


def _train_sequence(state: TrainState, clip: InMemoryClip, progress: Progress) -> float:
    """Train on the next sequence and advance the progress; returns the loss that was read last."""
    config, index = state.config, progress.sequences
    spp = sequence_budget(clip, config.spp or state.task.spp, config.seed, index)
    factor = config.lr_factor(progress.cycle_done)
    loss = state.train_sequence(clip, spp, factor, progress.fraction_done)
    progress.frames_seen += _count_frames(clip)
    progress.sequences += 1
    progress.steps = state.steps
    return loss


def _count_frames(clip: InMemoryClip) -> int:
    """Crops in a batch: each frame of each clip counts."""
    return len(clip) * clip.size.n


@dataclass(frozen=True)
class TrainingRuns:
    """How and where methods are trained."""

    out: Path  # the folder of all runs
    config: TrainingConfig
    device: str = "cpu"
    graph: bool = False  # record each step as a CUDA graph
    minutes: float = math.inf  # for each method
    command: str = ""  # recorded in the model cards
    allow_config_change: bool = False  # resume checkpoints that have a different config
    progress_bar: ProgressBar = lambda title, frames: nullcontext(lambda progress, loss: None)
    suffix: str = ""  # of the folders of all runs
    start: Path | None = None  # weights file from which new runs start

    def folder(self, method: str, held_out_scene: str | None = None) -> Path:
        """The folder of a run, as `run_folder` names it."""
        return run_folder(self.out, method, held_out_scene, self.config.spp, self.suffix)

    def check(self, methods: Sequence[str]) -> None:
        """Raise TrainingError if one of the methods does not support a training budget."""
        for method in methods:
            _check_budgets(method, self.config)

    def check_clips(self, methods: Sequence[str], split: TrainingSplit) -> None:
        """Raise BatchError if one of the methods cannot use a clip of the split."""
        for method in methods:
            clips = [*split.train, *split.mixed_in]
            _check_clips(method, clips, split.validation, self.config.crop, self.config.spp)

    def train(self, method: str, split: TrainingSplit, held_out_scene: str | None = None) -> Path:
        """Train a method, resume its run, or reuse it if it is finished; returns the weights.

        Raises FolderInUseError where another process trains in the same folder.
        """
        folder = self.folder(method, held_out_scene)
        with locked_folder(folder), self.progress_bar(method, self.config.frames) as on_progress:
            result = train(
                method,
                split.train,
                split.validation,
                folder,
                self.config,
                device=self.device,
                graph=self.graph,
                minutes=self.minutes,
                command=self.command,
                on_progress=on_progress,
                allow_config_change=self.allow_config_change,
                remark=split.remark,
                mixed_in=split.mixed_in,
                start=self.start,
                further=split.further,
            )
        return result.weights


def archive_run(folder: Path) -> Path | None:
    """Rename the folder of a run to NAME.old-N; returns its new path, or None if there is none.

    Raises FolderInUseError where another process trains in it.
    """
    if not folder.exists():
        return None
    with locked_folder(folder):
        pass
    number = 1
    while (archived := folder.with_name(f"{folder.name}.old-{number}")).exists():
        number += 1
    folder.rename(archived)
    return archived
