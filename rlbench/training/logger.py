"""What a training tells over time: lines of JSON, and TensorBoard where it is installed."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rlbench.system import paths
from rlbench.training.progress import Progress
from rlbench.training.validation import ValidationResult

LOG = "log.jsonl"  # one line a validation
FOLDER = "tensorboard"
GAMMA = 1 / 2.2  # of pictures, which are there to be looked at and not measured


class TrainingLogger:
    """The curves of one training; those of a resumed one go on where its checkpoint was."""

    def __init__(self, folder: Path, seen: int) -> None:
        """Forget what was told after `seen` frames, by a training that was killed after them."""
        self.log = folder / LOG
        self.board = _board(folder / FOLDER, seen)
        _trim(self.log, seen)

    def sequence(self, progress: Progress, loss: float, rate: float) -> None:
        """Tell of one sequence; `rate` is the learning rate."""
        told = {"loss": loss, "learning rate": rate, "frames a second": progress.speed}
        for name, value in told.items() if self.board else ():
            self.board.add_scalar(name, value, progress.seen)

    def validated(self, progress: Progress, loss: float, found: ValidationResult) -> None:
        """Tell of a validation, and have all of it on disk."""
        line = {"seen": progress.seen, "loss": loss, "seconds": progress.seconds}
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("a") as file:
            file.write(json.dumps({**line, "psnr": found.psnr}) + "\n")
        if self.board:
            self.board.add_scalar("validation PSNR", found.psnr, progress.seen)
            if found.picture is not None:
                shown = found.picture.clamp(0, 1).pow(GAMMA).nan_to_num().cpu()
                self.board.add_image("validation, reference at the right", shown, progress.seen)
            self.board.flush()


@contextmanager
def told(folder: Path, seen: int) -> Iterator[TrainingLogger]:
    """The curves of a training that stands at `seen` frames, closed at the end."""
    curves = TrainingLogger(folder, seen)
    try:
        yield curves
    finally:
        if curves.board:
            curves.board.close()


def lacking() -> str:
    """What is missed where TensorBoard is not installed, in one line; empty where it is."""
    if importlib.util.find_spec("tensorboard"):
        return ""
    return f'no TensorBoard here, only {LOG}: pip install "rlbench[train]" brings it'


def _board(folder: Path, seen: int) -> Any:
    """TensorBoard's writer, or None; of what was written before, it hides all after `seen`."""
    if lacking():
        return None
    from torch.utils.tensorboard import SummaryWriter

    purge = {"purge_step": seen + 1} if folder.exists() else {}
    return SummaryWriter(str(folder), **purge)


def _trim(log: Path, seen: int) -> None:
    """Drop lines of a log that were written after `seen` frames, or cut short."""
    lines = log.read_text().splitlines(keepends=True) if log.exists() else []
    kept = [line for line in lines if line.endswith("\n") and json.loads(line)["seen"] <= seen]
    if kept != lines:
        with paths.replacing(log) as temporary:
            temporary.write_text("".join(kept))
