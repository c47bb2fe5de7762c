"""A course of trainings: method after method by one plan, each in a folder of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rlbench import registry
from rlbench.cli import console
from rlbench.training import lr_range_test
from rlbench.training.config import TrainingConfig
from rlbench.training.dataset import TrainingSplit
from rlbench.training.loop import check, shipped, train

Bar = Callable[[str, int], AbstractContextManager[Callable[[Any, float], None]]]


@dataclass(frozen=True)
class TrainingRuns:
    """How methods are trained, and where."""

    out: Path
    plan: TrainingConfig
    device: str = "cpu"
    minutes: float = math.inf  # of each method
    command: str = ""
    allow_config_change: bool = False  # may it go on from a checkpoint of another plan?
    bar: Bar = console.training

    def folder(self, name: str, without: str | None = None) -> Path:
        """Where a method's training lies: one folder for a variant, fold, and choice of budgets."""
        fold = f"-without-{without}" if without else ""
        budgets = "+".join(f"{spp:g}" for spp in self.plan.spp)
        return self.out / (name.replace("/", "-") + fold + (f"-{budgets}spp" if budgets else ""))

    def check(self, names: Sequence[str]) -> None:
        """Raise TrainingError where one of the methods cannot be trained, before any is."""
        for name in names:
            check(name, self.plan)

    def train(self, name: str, chosen: TrainingSplit, without: str | None = None) -> Path:
        """The weights of a method, trained now or before on those clips."""
        folder = self.folder(name, without)
        with self.bar(name, self.plan.frames) as tell:
            train(
                name,
                chosen.train,
                chosen.validate,
                folder,
                self.plan,
                self.device,
                self.minutes,
                self.command,
                tell,
                self.allow_config_change,
            )
        return shipped(name, folder)

    def range_test(self, name: str, chosen: TrainingSplit) -> lr_range_test.LrRangeResult:
        """The learning rates of a method, tried on the same clips."""
        folder = self.out / f"{self.folder(name).name}-range"
        with self.bar(f"{name}, range test", self.plan.frames) as tell:
            return lr_range_test.run(name, chosen.train, folder, self.plan, self.device, tell)


def archive_run(folder: Path) -> Path | None:
    """Move a training out of the way; returns where it is now, or None where there was none."""
    if not folder.exists():
        return None
    number = 1
    while (aside := folder.with_name(f"{folder.name}.old-{number}")).exists():
        number += 1
    folder.rename(aside)
    return aside


def learners(names: Sequence[str]) -> list[str]:
    """Those of the methods that there is something to train of."""
    return [name for name in names if registry.is_trainable(name)]
