"""The folder of a training run: its name, its log and status, and what others read from them.

`status.json` is replaced every ten seconds and at the end, and holds one object: `method`, `frames`
(to train on), `frames_seen`, `frames_per_second`, `seconds`, `loss`, `validation` (the last one: by
set, `psnr`, `first_frames` and `drift` in dB), `best` (frames seen and PSNR of the weights that are
kept, or null) and `finished`. `log.jsonl` holds a line for each validation; TensorBoard has all, if
it is installed. Imports no torch, so that the state of a run can be read while others train.
"""

from __future__ import annotations

import importlib.util
import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlbench import registry
from rlbench.errors import OptionError, PluginError
from rlbench.system.store import read_text, write_text

if TYPE_CHECKING:
    from rlbench.training.checkpoint import Progress
    from rlbench.training.train_state import ValidationResult

CHECKPOINT = "checkpoint.safetensors"
LOG = "log.jsonl"  # one line per validation
STATUS = "status.json"  # the present state
QUICK = "-quick"  # suffix of the folders of quick trainings
SPEED_LINES = 6  # last validations over which the speed is measured
TENSORBOARD = "tensorboard"
# of each set, in TensorBoard
CURVES = ("validation PSNR", "validation PSNR of first frames", "validation drift")
PREVIEW_GAMMA = 1 / 2.2  # previews are for viewing only, not for measuring


def run_folder(
    out: Path,
    method: str,
    held_out_scene: str | None = None,
    spp: Sequence[float] = (),
    suffix: str = "",
) -> Path:
    """The folder of a run in `out`; one for each combination of method, held-out scene and budgets.

    >>> run_folder(Path("runs"), "ours/A1", "hall", (0.5, 4.0)).as_posix()
    'runs/ours-A1-without-hall-0.5+4spp'
    """
    fold = f"-without-{held_out_scene}" if held_out_scene else ""
    budgets = "+".join(f"{each:g}" for each in spp)
    budgets = f"-{budgets}spp" if budgets else ""
    return out / (method.replace("/", "-") + fold + budgets + suffix)


def weights_path(method: str, folder: Path) -> Path:
    """The weights file that a run of `method` writes to its folder.

    >>> weights_path("ours/A1", Path("runs/ours-A1")).as_posix()
    'runs/ours-A1/A1.safetensors'
    """
    family, _, variant = method.partition("/")
    return folder / f"{variant or family}.safetensors"


def find_weights(start: str | None, out: Path, methods: Sequence[str] = ()) -> Path | None:
    """The weights file `start`, that of the finished run `start` in `out`, or the shipped ones.

    A run is named by its method or by its folder. Shipped weights are taken where `out` has no such
    folder, and of `methods`, which are trained, so that no run starts from itself when it resumes.
    None for None. Raises OptionError where there is none of them.
    """
    if start is None:
        return None
    if (file := Path(start)).is_file():
        return file
    folder = run_folder(out, start)
    found = [card.with_suffix(".safetensors") for card in sorted(folder.glob("*.toml"))]
    if start in methods or not folder.exists():
        with suppress(PluginError):  # no such method
            found = [file for file in [registry.shipped_weights(start)] if file.is_file()]
    if len(found) == 1:
        return found[0]
    raise OptionError(
        f"--start {start}: there is no such weights file, {folder} holds no weights of a finished "
        "run, and no such row has shipped weights. Name a safetensors file, a run in the folder "
        "--out, or a row"
    )


@dataclass(frozen=True)
class RunState:
    """How far a run is."""

    frames: int = 0  # to train on; 0 if the run has not begun
    frames_seen: int = 0
    speed: float = 0.0  # frames a second, validations included; 0 if unknown
    validation: dict[str, float] = field(default_factory=dict)  # last PSNR of each set, dB

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the end at this speed; None if the speed is unknown."""
        left = max(self.frames - self.frames_seen, 0)
        return left / self.speed if self.speed > 0 else None


def read_state(folder: Path) -> RunState:
    """The state that a run last wrote to its folder; that of no run where it wrote none."""
    try:
        status = json.loads((folder / STATUS).read_text())
    except (OSError, ValueError):
        return RunState()
    return RunState(
        int(status["frames"]),
        int(status["frames_seen"]),
        _measure_speed(folder / LOG, status),
        {name: float(score["psnr"]) for name, score in status["validation"].items()},
    )


def _measure_speed(log: Path, status: dict[str, Any]) -> float:
    """Frames a second over the last validations, else over the whole run."""
    points = [(int(status["frames_seen"]), float(status["seconds"]))]
    last = [json.loads(line) for line in _complete_lines(log)[-SPEED_LINES:]]
    points += [(int(line["frames_seen"]), float(line["seconds"])) for line in last]
    begin, end = min(points), max(points)
    if begin == end:
        begin = (0, 0.0)
    frames, seconds = end[0] - begin[0], end[1] - begin[1]
    return frames / seconds if seconds > 0 else 0.0


def _complete_lines(log: Path) -> list[str]:
    """The lines of a log, without one that a kill cut off; none if there is no log."""
    lines = read_text(log).splitlines(keepends=True)
    return [line for line in lines if line.endswith("\n")]


class TrainingLogger:
    """Logs one training run. The log of a resumed run continues where its checkpoint was saved.

    Use it with `contextlib.closing`.
    """

    def __init__(self, folder: Path, frames_seen: int) -> None:
        """Drop log entries written after `frames_seen` frames, by a run that was then killed."""
        self.log, self.status = folder / LOG, folder / STATUS
        self.tensorboard = _open_tensorboard(folder / TENSORBOARD, frames_seen)
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
        """Replace the status of the run."""
        last = {name: curve[-1] for name, curve in progress.curves.items() if curve}
        status = {
            "method": progress.config["method"],
            "frames": progress.frames_goal,
            "frames_seen": progress.frames_seen,
            "frames_per_second": progress.frames_per_second,
            "seconds": progress.seconds,
            "loss": loss if math.isfinite(loss) else None,
            "validation": {
                name: {"psnr": psnr, "first_frames": first, "drift": progress.drift[name]}
                for name, (_, psnr, first) in last.items()
            },
            "best": progress.best,
            "finished": progress.fraction_done >= 1,
        }
        write_text(self.status, json.dumps(status))

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
    text = read_text(log)
    lines = _complete_lines(log)
    valid = "".join(line for line in lines if json.loads(line)["frames_seen"] <= frames_seen)
    if valid != text:
        write_text(log, valid)
