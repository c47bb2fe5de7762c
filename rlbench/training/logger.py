"""The log of a training run: a JSON line per validation, a status, and TensorBoard if installed.

Other programs read the state of a run from its folder. `status.json` is replaced every ten seconds
and at the end, and holds one object: `method`, `frames` (to train on), `frames_seen`,
`frames_per_second`, `seconds`, `loss`, `validation` (the last one: by set, `psnr` and
`first_frames` in dB), `best` (frames seen and PSNR of the weights that are kept, or null) and
`finished`. `log.jsonl` holds a line for each validation.
"""

from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path
from typing import Any

from rlbench.system import paths
from rlbench.training.checkpoint import Progress
from rlbench.training.run_folder import LOG, STATUS
from rlbench.training.validation import ValidationResult

__all__ = ["TrainingLogger", "tensorboard_hint"]

FOLDER = "tensorboard"
CURVES = ("validation PSNR", "validation PSNR of first frames")  # of each set, in TensorBoard
PREVIEW_GAMMA = 1 / 2.2  # previews are for viewing only, not for measuring


class TrainingLogger:
    """Logs one training run. The log of a resumed run continues where its checkpoint was saved.

    Use it with `contextlib.closing`.
    """

    def __init__(self, folder: Path, frames_seen: int) -> None:
        """Drop log entries written after `frames_seen` frames, by a run that was then killed."""
        self.log, self.status = folder / LOG, folder / STATUS
        self.tensorboard = _open_tensorboard(folder / FOLDER, frames_seen)
        _truncate_log(self.log, frames_seen)

    def log_sequence(self, progress: Progress, loss: float, learning_rate: float) -> None:
        """Log one sequence to TensorBoard."""
        if self.tensorboard is None:
            return
        scalars = {
            "loss": loss,
            "learning rate": learning_rate,
            "frames a second": progress.frames_per_second,
        }
        for name, value in scalars.items():
            self.tensorboard.add_scalar(name, value, progress.frames_seen)

    def log_validation(self, progress: Progress, loss: float, result: ValidationResult) -> None:
        """Log one validation, and write all entries to disk."""
        line = {
            "frames_seen": progress.frames_seen,
            "loss": loss,
            "seconds": progress.seconds,
            "frames_per_second": progress.frames_per_second,
            "psnr": result.psnr,
            "validation": {name: score._asdict() for name, score in result.sets.items()},
        }
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("a") as file:
            file.write(json.dumps(line) + "\n")
        if self.tensorboard is None:
            return
        self.tensorboard.add_scalar("validation PSNR", result.psnr, progress.frames_seen)
        for name, score in result.sets.items():
            for quantity, psnr in zip(CURVES, score, strict=True):
                self.tensorboard.add_scalar(f"{quantity}/{name}", psnr, progress.frames_seen)
        if result.preview is not None:
            preview = result.preview.clamp(0, 1).pow(PREVIEW_GAMMA).nan_to_num().cpu()
            title = "validation, reference at the right"
            self.tensorboard.add_image(title, preview, progress.frames_seen)
        self.tensorboard.flush()

    def write_status(self, progress: Progress, loss: float) -> None:
        """Replace the status of the run; its length is that of the config."""
        frames = int(progress.config["frames"])
        last = {name: curve[-1] for name, curve in progress.curves.items() if curve}
        status = {
            "method": progress.config["method"],
            "frames": frames,
            "frames_seen": progress.frames_seen,
            "frames_per_second": progress.frames_per_second,
            "seconds": progress.seconds,
            "loss": loss if math.isfinite(loss) else None,
            "validation": {
                name: {"psnr": psnr, "first_frames": first}
                for name, (_, psnr, first) in last.items()
            },
            "best": progress.best,
            "finished": progress.frames_seen >= frames,
        }
        with paths.atomic_write(self.status) as temporary:
            temporary.write_text(json.dumps(status))

    def close(self) -> None:
        """Close TensorBoard's file."""
        if self.tensorboard is not None:
            self.tensorboard.close()


def tensorboard_hint() -> str:
    """One line that says how to install TensorBoard; empty if it is installed."""
    if importlib.util.find_spec("tensorboard"):
        return ""
    return (
        f"TensorBoard is not installed, so training logs to {LOG} only. To install it: "
        'pip install "rlbench[train]"'
    )


def _open_tensorboard(folder: Path, frames_seen: int) -> Any:
    """TensorBoard's writer, which hides older entries after `frames_seen`; None without it."""
    if tensorboard_hint():
        return None
    from torch.utils.tensorboard import SummaryWriter

    purge = {"purge_step": frames_seen + 1} if folder.exists() else {}
    return SummaryWriter(str(folder), **purge)


def _truncate_log(log: Path, frames_seen: int) -> None:
    """Drop lines that were written after `frames_seen` frames, or are incomplete."""
    lines = log.read_text().splitlines(keepends=True) if log.exists() else []
    complete = [line for line in lines if line.endswith("\n")]
    valid = [line for line in complete if json.loads(line)["frames_seen"] <= frames_seen]
    if valid != lines:
        with paths.atomic_write(log) as temporary:
            temporary.write_text("".join(valid))
