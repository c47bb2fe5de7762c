"""The table of compare_learners: one CSV row for each score during a training."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from rlbench.system import paths

__all__ = ["TABLE", "LearnerTable", "Training"]

TABLE = "known_optimum.csv"
COLUMNS = ("learner", "mode", "seed", "side", "of", "frames", "seconds", "score")  # of: in all


class Training(NamedTuple):
    """The identity of one training."""

    learner: str
    mode: str
    seed: int

    def __str__(self) -> str:
        """For the progress bar."""
        return f"{self.learner}, {self.mode}, seed {self.seed}"


@dataclass
class LearnerTable:
    """Scores of trainings of one length, on frames of one size."""

    file: Path
    frames: int
    side: int
    rows: list[dict[str, str]]

    @classmethod
    def read(cls, file: Path, frames: int, side: int) -> LearnerTable:
        """The table in a file, empty if there is none.

        Raises ValueError if it has trainings of another length, or on frames of another size.
        """
        rows: list[dict[str, str]] = []
        if file.exists():
            with file.open(newline="") as content:
                rows = list(csv.DictReader(content))
        if other := {(row["side"], row["of"]) for row in rows} - {(str(side), str(frames))}:
            found = " and ".join(f"--frames {of} --side {pixels}" for pixels, of in sorted(other))
            raise ValueError(
                f"--frames {frames} --side {side}: {file} has trainings by {found}, which cannot "
                "be compared with these. Choose another --out"
            )
        return cls(file, frames, side, rows)

    @property
    def trainings(self) -> set[Training]:
        """Trainings with scores in the table."""
        return {Training(row["learner"], row["mode"], int(row["seed"])) for row in self.rows}

    def add(self, training: Training, frames: int, seconds: float, score: float) -> None:
        """Append one score."""
        settings = (*training, self.side, self.frames)
        values = (*settings, frames, f"{seconds:.1f}", f"{score:.4f}")
        self.rows.append(dict(zip(COLUMNS, map(str, values), strict=True)))

    def write(self) -> None:
        """Replace the file."""
        with paths.atomic_write(self.file) as part, part.open("w", newline="") as out:
            writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(self.rows)
