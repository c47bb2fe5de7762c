"""The folder of a training run: its name, its files, and what other programs read from it.

Imports no torch, so that the state of a run can be read while others train.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rlbench import registry
from rlbench.errors import OptionError, PluginError

__all__ = [
    "CHECKPOINT",
    "LOG",
    "QUICK",
    "STATUS",
    "RunState",
    "find_weights",
    "read_state",
    "run_folder",
    "weights_path",
]

CHECKPOINT = "checkpoint.safetensors"
LOG = "log.jsonl"  # one line per validation
STATUS = "status.json"  # the present state
QUICK = "-quick"  # suffix of the folders of quick trainings
SPEED_LINES = 6  # last validations over which the speed is measured


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


def find_weights(start: str | None, out: Path) -> Path | None:
    """The weights file `start`, that of the finished run `start` in `out`, or the shipped ones.

    A run is named by its method or by its folder. A method's shipped weights are taken where `out`
    has no folder of its run. None for None. Raises OptionError where there is none of them.
    """
    if start is None:
        return None
    if (file := Path(start)).is_file():
        return file
    folder = run_folder(out, start)
    found = [card.with_suffix(".safetensors") for card in sorted(folder.glob("*.toml"))]
    if not folder.exists():
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
    is_finished: bool = False

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
        bool(status["finished"]),
    )


def _measure_speed(log: Path, status: dict[str, Any]) -> float:
    """Frames a second over the last validations, else over the whole run."""
    points = [(int(status["frames_seen"]), float(status["seconds"]))]
    points += [(int(line["frames_seen"]), float(line["seconds"])) for line in _last_lines(log)]
    first, last = min(points), max(points)
    if first == last:
        first = (0, 0.0)
    frames, seconds = last[0] - first[0], last[1] - first[1]
    return frames / seconds if seconds > 0 else 0.0


def _last_lines(log: Path) -> Iterator[dict[str, Any]]:
    """The complete ones of the last lines of a log."""
    lines = log.read_text().splitlines(keepends=True) if log.exists() else []
    yield from (json.loads(line) for line in lines[-SPEED_LINES:] if line.endswith("\n"))
