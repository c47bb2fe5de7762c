"""Training runs of several methods with one config, each in a folder of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from rlbench import registry
from rlbench.system.folder_lock import locked_folder
from rlbench.training import own_clips
from rlbench.training.checkpoint import Progress
from rlbench.training.dataset import TrainingSplit
from rlbench.training.loop import check_budgets, train
from rlbench.training.run_folder import run_folder
from rlbench.training.task import TrainingConfig

__all__ = ["TrainingRuns", "archive_run"]

OnProgress = Callable[[Progress, float], None]  # progress and loss, after each sequence
# (title, total frames) -> a context in which the returned callback shows the progress
ProgressBar = Callable[[str, int], AbstractContextManager[OnProgress]]


def hidden_progress(title: str, frames: int) -> AbstractContextManager[OnProgress]:
    """A progress bar that shows nothing."""
    return nullcontext(lambda progress, loss: None)


@dataclass(frozen=True)
class TrainingRuns:
    """How and where methods are trained."""

    out: Path  # the folder of all runs
    config: TrainingConfig
    device: str = "cpu"
    minutes: float = math.inf  # for each method
    command: str = ""  # recorded in the model cards
    allow_config_change: bool = False  # resume checkpoints that have a different config
    progress_bar: ProgressBar = hidden_progress
    suffix: str = ""  # of the folders of all runs
    start: Path | None = None  # weights file from which new runs start

    def folder(self, method: str, held_out_scene: str | None = None) -> Path:
        """The folder of a run, as `run_folder` names it."""
        return run_folder(self.out, method, held_out_scene, self.config.spp, self.suffix)

    def check(self, methods: Sequence[str]) -> None:
        """Raise TrainingError if one of the methods does not support a training budget."""
        for method in methods:
            check_budgets(method, self.config)

    def check_clips(self, methods: Sequence[str], split: TrainingSplit) -> None:
        """Raise BatchError if one of the methods cannot use a clip of the split."""
        for method in methods:
            traits, spp = registry.get_variant(method).traits, self.config.spp
            train_clips = [*split.train, *split.mixed_in]
            own_clips.check_clips(method, traits, train_clips, self.config.crop, spp)
            for clips in split.validation.values():
                own_clips.check_clips(method, traits, clips, 0, spp)

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
                self.device,
                self.minutes,
                self.command,
                on_progress,
                self.allow_config_change,
                split.remark,
                split.mixed_in,
                self.start,
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
