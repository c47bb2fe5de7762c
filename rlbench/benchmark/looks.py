"""The ledger of looks: when a run scored something new on clips that nobody may tune on.

A method that is changed after each look at a test set is fitted to it, whatever it was trained on
(Dwork et al. 2015, The Reusable Holdout). `looks.csv` in the results folder has one line for each
run and preset: the date, the methods, the number of new cells and a hash of the methods' code.
"""

from __future__ import annotations

import csv
import fcntl
import io
import logging
import os
from collections import Counter
from collections.abc import Collection
from contextlib import suppress
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path

from rlbench.benchmark.cell_key import CellKey
from rlbench.clips.presets import is_test_split
from rlbench.system.paths import open_to_append, write_error

_logger = logging.getLogger(__name__)

FILE = "looks.csv"
COLUMNS = ("date", "preset", "methods", "cells", "code_hash")


def record_looks(folder: Path, cells: Collection[tuple[CellKey, str]]) -> None:
    """Append a line for each test preset of `cells`, which are about to be scored.

    A cell comes with the hash of its method's code. A damaged ledger is set aside before.
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
        _set_aside_damaged(folder / FILE)
        _append(folder / FILE, lines)


def count_looks(folder: Path) -> dict[str, int]:
    """Number of runs by preset, from the ledger in `folder`; empty without one that can be read."""
    try:
        lines = _read(folder / FILE)
    except (OSError, ValueError) as error:
        _logger.warning("%s: %s; looks at test clips are not counted", folder / FILE, error)
        return {}
    return dict(Counter(preset for _, preset, *_ in lines if preset))


def _read(file: Path) -> list[list[str]]:
    """The lines of a ledger; none where there is no file. Raises ValueError for a damaged one."""
    if file.is_symlink():
        raise ValueError("it is a link")
    if not os.path.lexists(file):
        return []
    try:
        text = file.read_bytes().decode()
        header, *lines = csv.reader(io.StringIO(text, newline=""), strict=True)
    except (csv.Error, ValueError) as error:
        raise ValueError(f"it is damaged ({error})") from error
    if any(len(line) != len(COLUMNS) for line in lines) or tuple(header) != COLUMNS:
        raise ValueError("it is damaged (a line has not the columns of a ledger)")
    return lines


def _set_aside_damaged(file: Path) -> None:
    try:
        _read(file)
    except (OSError, ValueError) as error:
        aside = file.with_name(f"{file.name}.damaged")
        with suppress(OSError):  # of a read-only folder, which the append reports
            file.replace(aside)
            _logger.warning("%s was set aside as %s: %s", file, aside.name, error)


def _append(file: Path, lines: Collection[tuple[object, ...]]) -> None:
    with open_to_append(file) as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX)  # released when the file is closed
            is_new = os.fstat(stream.fileno()).st_size == 0
            text = io.StringIO(newline="")
            csv.writer(text, lineterminator="\n").writerows([*([COLUMNS] * is_new), *lines])
            stream.write(text.getvalue().encode())
        except OSError as error:
            raise write_error(file, error) from error
