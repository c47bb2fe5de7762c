"""The ledger of looks: when a run scored something new on clips that nobody may tune on.

A method that is changed after each look at a test set is fitted to it, whatever it was trained on
(Dwork et al. 2015, The Reusable Holdout). `looks.csv` in the results folder has one line for each
run and preset: the date, the methods, the number of new cells and a hash of the methods' code.
"""

from __future__ import annotations

import csv
import fcntl
import io
import os
from collections import Counter
from collections.abc import Collection
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path

from rlbench.benchmark.cell_key import CellKey
from rlbench.render.presets import is_test_split
from rlbench.system.paths import write_error

FILE = "looks.csv"
COLUMNS = ("date", "preset", "methods", "cells", "code_hash")


def record_looks(folder: Path, cells: Collection[tuple[CellKey, str]]) -> None:
    """Append a line for each test preset of `cells`, which are about to be scored.

    A cell comes with the hash of its method's code.
    Runs in parallel may append to one file: each locks it, and writes its lines at once. Raises
    WriteError where the folder takes no file.
    """
    lines = []
    for preset in filter(is_test_split, sorted({key.preset for key, _ in cells})):
        scored = [(key.method, code) for key, code in cells if key.preset == preset]
        names, hashes = (sorted(set(values)) for values in zip(*scored, strict=True))
        code = sha256(" ".join(hashes).encode()).hexdigest()[:16]
        date = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        lines.append((date, preset, " ".join(names), len(scored), code))
    if lines:
        _append(folder / FILE, lines)


def count_looks(folder: Path) -> dict[str, int]:
    """Number of runs by preset, from the ledger in `folder`; empty without one."""
    file = folder / FILE
    if not file.is_file():
        return {}
    with file.open(newline="", encoding="utf-8") as stream:
        return dict(Counter(row["preset"] for row in csv.DictReader(stream) if row["preset"]))


def _append(file: Path, lines: Collection[tuple[object, ...]]) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("ab", buffering=0) as stream:
            fcntl.flock(stream, fcntl.LOCK_EX)  # released when the file is closed
            is_new = os.fstat(stream.fileno()).st_size == 0
            text = io.StringIO(newline="")
            csv.writer(text, lineterminator="\n").writerows([*([COLUMNS] * is_new), *lines])
            stream.write(text.getvalue().encode())
    except OSError as error:
        raise write_error(file, error) from error
