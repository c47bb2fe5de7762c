"""What is said of an error in the code of a plugin: its type, its text, and the line it came from.

TypeError: unsupported operand type(s) for +: 'NoneType' and 'int' (bright.py:21)
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable
from pathlib import Path

OURS = Path(__file__).parents[1]
PACKAGES = "site-packages"  # of an environment that lies beside a plugin
FRAMES = "rlbench_frames"  # attribute of an error that comes from another process


def describe_failure(error: BaseException, *folders: Path) -> str:
    """The error, the last line of code in `folders` that it passed through, and its short notes.

    A line in the first folder is preferred to one in the second, and so on. Of a file that does not
    parse, it is the line that is wrong.

    >>> describe_failure(ValueError("no luck"))
    'ValueError: no luck'
    """
    text = error.msg if isinstance(error, SyntaxError) else str(error)  # its str names a place too
    lines = [line for folder in folders for line in _lines(error, folder)]
    place = f" ({lines[0]})" if lines else ""
    notes = "".join(f", {note}" for note in getattr(error, "__notes__", ()) if "\n" not in note)
    return f"{type(error).__name__}: {text}{place}{notes}"


def keep_frames(error: BaseException) -> None:
    """Let the error name its line in another process too, to which its traceback cannot go."""
    setattr(error, FRAMES, _frames(error))


def point_at(error: BaseException, function: Callable[..., object]) -> None:
    """Let the error name the first line of a function of a plugin that did not raise it."""
    if code := getattr(inspect.unwrap(function), "__code__", None):
        setattr(error, FRAMES, [(code.co_filename, code.co_firstlineno)])


def _frames(error: BaseException) -> list[tuple[str, int | None]]:
    """File and line of each call that an error passed through, last first."""
    own = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    kept: list[tuple[str, int | None]] = getattr(error, FRAMES, [])
    return kept + own[::-1]


def _lines(error: BaseException, folder: Path) -> list[str]:
    """The lines `file.py:NUMBER` of code in a folder that an error passed through, last first."""
    places = _frames(error)
    if isinstance(error, SyntaxError) and error.filename:
        places.insert(0, (error.filename, error.lineno))
    return [f"{Path(file).name}:{line}" for file, line in places if _is_code_of(folder, Path(file))]


def _is_code_of(folder: Path, file: Path) -> bool:
    """True if a file is below a folder, and neither of an installed package nor of rlbench."""
    if not file.is_relative_to(folder) or PACKAGES in file.relative_to(folder).parts:
        return False
    return folder.is_relative_to(OURS) or not file.is_relative_to(OURS)
