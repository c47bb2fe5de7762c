"""Patterns of file names with placeholders, as in `beauty.{sample}.{frame}.exr`.

| in a pattern | matches |
|---|---|
| `{frame}` | the number of the frame, negative ones with their - |
| `{sample}` | the number of a sample |
| `{half}` | the number or the letters of a half of the reference |
| `{spp}` | samples per pixel of an image |
| `{clip}` | the name of a clip, which may contain folders |
| `*` | anything but a slash |
| `**/` | any folders, or none |
| `[...]` | what is in the brackets, or nothing |

A pattern is matched against the path below the dump, with slashes. A - before the number of a frame
is its sign if a slash, a dot, an underscore, a space, or text of the pattern itself is before it.
After a word that `*` or `{clip}` stands for it may be a dash: `SignReader` tells from all files.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from functools import cache
from pathlib import PurePath
from typing import NamedTuple

from rlbench.errors import SourceError

PLACEHOLDERS = {
    "frame": r"-?\d{1,18}",
    "sample": r"\d{1,18}",
    "half": r"[A-Za-z]|\d{1,18}",
    "spp": r"\d{1,9}",
    "clip": r".*?",
}
FIRST_FRAMES = 100  # a run of frames below zero comes nearer to zero than this
WILD_FRAME = re.compile(r"(\*|\{clip\})\[?\{frame\}")
TOKEN = re.compile(r"\{(\w*)\}|(\*\*/)|(\*)|(\[)|(\])")


class FileKey(NamedTuple):
    """What the name of a file says; empty or 0 for what it does not say."""

    clip: str = ""
    frame: int = 0
    sample: int = 0  # or the half of a reference
    spp: int = 0  # 0: unknown


def match_pattern(pattern: str, path: PurePath) -> FileKey | None:
    """What a path below the dump says, None where it does not match. Raises SourceError.

    >>> match_pattern("{clip}_[seed{sample}_]{frame}.exr", PurePath("hall_seed3_0012.exr"))
    FileKey(clip='hall', frame=12, sample=3, spp=0)
    """
    match = _compile(pattern).fullmatch(path.as_posix())
    return _decode(match) if match else None


class SignReader:
    """Tells signs from dashes, from the names of all files that match the patterns of a dump."""

    def __init__(self, paths: Iterable[PurePath], patterns: Iterable[str]) -> None:
        """Collect the numbers after each word. Raises SourceError for a wrong pattern."""
        self._numbers: dict[str, list[str]] = defaultdict(list)  # by word and whether - follows it
        wild = [pattern for pattern in patterns if WILD_FRAME.search(pattern)]
        for path in paths if wild else ():
            for match in filter(None, (_compile(p).fullmatch(path.as_posix()) for p in wild)):
                if match["frame"]:
                    sign = "-" * match["frame"].startswith("-")
                    self._numbers[_word(match) + sign].append(match["frame"])

    def match(self, pattern: str, path: PurePath) -> FileKey | None:
        """As `match_pattern`, where a dash is none of the number.

        Raises SourceError where nothing tells whether frames are negative.
        """
        match = _compile(pattern).fullmatch(path.as_posix())
        if not match:
            return None
        key = _decode(match)
        if key.frame >= 0 or not WILD_FRAME.search(pattern):
            return key
        word = _word(match)
        if word in self._numbers or not word[-1:].isalnum():
            return key
        numbers = [abs(int(number)) for number in self._numbers[word + "-"]]
        if 0 < min(numbers) < FIRST_FRAMES:
            raise SourceError(
                f"{path}: is it frame {key.frame}, or frame {-key.frame} after a dash? Say so by "
                f"the text before {{frame}} in `files`: {word}{{frame}} for {key.frame}, "
                f"{word}-{{frame}} for {-key.frame}. rlbench lint --guess writes such a layout"
            )
        return key._replace(frame=-key.frame, clip=key.clip and f"{key.clip}-")


def _word(match: re.Match[str]) -> str:
    """What the name of a file has before the number of its frame."""
    return match.string[: match.start("frame")].rpartition("/")[2]


def _decode(match: re.Match[str]) -> FileKey:
    found = {key: value for key, value in match.groupdict().items() if value}
    half = found.get("half", "")
    sample = found.get("sample") or (half if half.isdecimal() else str(ord(half)) if half else "0")
    return FileKey(
        found.get("clip", ""), int(found.get("frame", 0)), int(sample), int(found.get("spp", 0))
    )


@cache
def _compile(pattern: str) -> re.Pattern[str]:
    parts, position, names = [], 0, set()
    for token in TOKEN.finditer(pattern):
        parts.append(re.escape(pattern[position : token.start()]))
        position = token.end()
        if (name := token[1]) is not None:
            if name not in PLACEHOLDERS:
                known = ", ".join(f"{{{each}}}" for each in PLACEHOLDERS)
                raise SourceError(f"'{pattern}': no placeholder {{{name}}}; there are: {known}")
            parts.append(f"(?P={name})" if name in names else f"(?P<{name}>{PLACEHOLDERS[name]})")
            names.add(name)
        else:
            parts.append({"**/": "(?:.*?/)??", "*": "[^/]*?", "[": "(?:", "]": ")?"}[token[0]])
    if pattern.count("[") != pattern.count("]"):
        raise SourceError(f"'{pattern}' has {pattern.count('[')} [ and {pattern.count(']')} ]")
    return re.compile("".join([*parts, re.escape(pattern[position:])]))
