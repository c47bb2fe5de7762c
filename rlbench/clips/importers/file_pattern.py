"""Patterns of file names with placeholders, as in `beauty.{sample}.{frame}.exr`.

| in a pattern | matches |
|---|---|
| `{frame}` | the number of the frame |
| `{sample}` | the number of a sample |
| `{half}` | the number or the letters of a half of the reference |
| `{spp}` | samples per pixel of an image |
| `{clip}` | the name of a clip, which may contain folders |
| `*` | anything but a slash |
| `**/` | any folders, or none |
| `[...]` | what is in the brackets, or nothing |

A pattern is matched against the path below the dump, with slashes.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import PurePath
from typing import NamedTuple

from rlbench.clips.importers.sequence import SourceError

__all__ = ["FileKey", "match_pattern"]

PLACEHOLDERS = {
    "frame": r"\d{1,18}",
    "sample": r"\d{1,18}",
    "half": r"[A-Za-z]|\d{1,18}",
    "spp": r"\d{1,9}",
    "clip": r".*?",
}
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
    if not match:
        return None
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
