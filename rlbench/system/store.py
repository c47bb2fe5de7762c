"""Text files that say what is done already; they are written whole, and an absent one is empty.

A key file lies beside files and names all that they were made of: while it holds the key of what is
asked for, they need not be made again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

from rlbench.system import paths

T = TypeVar("T")


def read_text(file: Path) -> str:
    """The content of a text file; empty where there is none."""
    return file.read_text(encoding="utf-8") if file.is_file() else ""


def write_text(file: Path, text: str) -> None:
    """Write a text file atomically. Raises WriteError as `rlbench.system.paths.atomic_write`."""
    with paths.atomic_write(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def claim(key_file: Path, key: str, older: Iterable[Path] = ()) -> None:
    """Write the key of files that are made next; those of another key, `older`, are removed."""
    if read_text(key_file) != key:
        for file in older:
            file.unlink(missing_ok=True)
        write_text(key_file, key)


def recall(file: Path, key: str, find: Callable[[], T]) -> T:
    """The answer to `key` from a JSON file of answers; where it has none, it is found and added."""
    answers: dict[str, Any] = json.loads(read_text(file) or "{}")
    if key not in answers:
        answers[key] = find()
        write_text(file, json.dumps(answers, indent=1))
    answer: T = answers[key]
    return answer
