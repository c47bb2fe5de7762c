"""The numbers in the names of a dump's files: frames, samples, samples per pixel, shots, versions.

A number is told by the word before it, and by what it does: the number that varies together with
that of the reference is the frame.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

NUMBER = re.compile(r"(?:(?<=[/._ -])-|^-)?\d+")  # a sign stands after a separator
KINDS = {  # of a number, by the word before it; `spp` may be after it
    "frame": ("frame", "fr", "f"),
    "sample": ("sample", "samples", "seed", "smp", "s"),
    "spp": ("spp", "acc", "accum", "accumulated"),
    "clip": ("shot", "sh", "seq", "sequence", "scene", "sc"),
    "": ("v", "ver", "version", "rev", "udim", "lod", "mip", "cam", "camera", "take"),  # literal
}
KIND_OF = {word: kind for kind, words in KINDS.items() for word in words}
HALVES = re.compile(r"(?i)(reference|converged|groundtruth|ref|half|gt)([_-]?)([AB])(?=[/._-])")
Group = list[tuple[str, list[str]]]  # paths of one skeleton, each with its numbers


class _Column(NamedTuple):
    """One number of the names of a group: its kind by the word beside it, and its values."""

    kind: str | None  # None: not told by a word
    values: tuple[int, ...]  # of each file

    @property
    def varies(self) -> bool:
        return len(set(self.values)) > 1


def find_patterns(
    paths: Iterable[str], is_reference: Callable[[str], bool] = lambda path: False
) -> dict[str, list[str]]:
    """The patterns of a dump's files, as a layout has them, each with the paths that have it.

    `is_reference` tells which paths are references.

    >>> find_patterns(["sample3/view.0012.exr", "sample3/view.0013.exr"]).popitem()[0]
    'sample{sample}/view.{frame}.exr'
    >>> list(find_patterns(["frame0007/noisy_v002_seed2_0001spp.exr"]))
    ['frame{frame}/noisy_v002_seed{sample}_{spp}spp.exr']
    """
    groups = _group(sorted(paths))
    tables = {skeleton: _columns(skeleton, group) for skeleton, group in groups.items()}
    frames: set[int] = set()  # numbers of references
    for skeleton, columns in tables.items():
        if is_reference(skeleton):
            index = _frame_column(columns, set())
            frames |= set(columns[index].values) if index is not None else set()
    found: dict[str, list[str]] = defaultdict(list)
    for skeleton, group in groups.items():
        kinds = _name_columns(tables[skeleton], frames)
        pattern = _fill(skeleton, group, kinds)
        found[pattern] += [path for path, _ in group]
    return {pattern: sorted(files) for pattern, files in sorted(found.items())}


def _group(paths: Sequence[str]) -> dict[str, Group]:
    """Paths by what their names have in common: # for each number, but for literal ones.

    A - between a word and a number is a sign where the same name is there without it.
    """
    known = {_skeleton(path, NUMBER)[0] for path in paths}
    signed = re.compile(r"-?\d+")
    groups: dict[str, Group] = defaultdict(list)
    for path in paths:
        skeleton, numbers = _skeleton(path, NUMBER)
        without, with_signs = _skeleton(path, signed)
        if "-" in skeleton and without != skeleton and without in known:
            skeleton, numbers = without, with_signs
        groups[skeleton].append((path, numbers))
    return groups


def _skeleton(path: str, number: re.Pattern[str]) -> tuple[str, list[str]]:
    """The path with # for each number that is not literal, and those numbers."""
    numbers: list[str] = []

    def replace(match: re.Match[str]) -> str:
        if KIND_OF.get(_word_before(path[: match.start()])) == "":
            return match[0]
        numbers.append(match[0])
        return "#"

    clean = re.sub(r"[#*{}\[\]]", "\0", path)  # what means something else in a pattern
    return number.sub(replace, clean).replace("\0", "*"), numbers


def _word_before(text: str) -> str:
    found = re.search(r"([A-Za-z]*)[_.=-]?$", text)
    return found[1].lower() if found else ""


def _columns(skeleton: str, group: Group) -> list[_Column]:
    """The numbers of a group, left to right."""
    pieces = skeleton.split("#")
    columns = []
    for index in range(len(pieces) - 1):
        kind = KIND_OF.get(_word_before(pieces[index]))
        if _is_followed_by_spp(pieces[index + 1].lower(), index + 2 < len(pieces)):
            kind = "spp"
        columns.append(_Column(kind, tuple(int(numbers[index]) for _, numbers in group)))
    return columns


def _is_followed_by_spp(text: str, is_before_number: bool) -> bool:
    """Whether text begins with spp, and that does not belong to a number after it."""
    match = re.match(r"([_.]?)spp(?![a-z])", text)
    if not match:
        return False
    is_between = is_before_number and not re.search("[a-z]", text[match.end() :])
    return not is_between or (not match[1] and match[0] != text)


def _frame_column(columns: Sequence[_Column], frames: set[int]) -> int | None:
    """The index of the frame's number, None where no number can be it.

    In this order: a number after the word frame, one whose values are `frames`, one that varies,
    the last one.
    """

    def fitness(index: int) -> tuple[bool, bool, float, bool, int, int]:
        column, values = columns[index], set(columns[index].values)
        shared = len(values & frames) / len(values | frames) if frames else 0.0
        is_plain = column.kind is None
        return (
            column.kind == "frame",
            is_plain and column.varies,
            shared,
            is_plain,
            len(values),
            index,
        )

    usable = [i for i, column in enumerate(columns) if column.kind in (None, "frame", "clip")]
    return max(usable, key=fitness, default=None)


def _name_columns(columns: Sequence[_Column], frames: set[int]) -> list[str]:
    """The placeholder of each number; empty for one that stays as it is."""
    frame = _frame_column(columns, frames)
    frame_values = () if frame is None else columns[frame].values
    kinds = []
    for index, column in enumerate(columns):
        if index == frame or (column.varies and column.values == frame_values):
            kinds.append("frame")
        elif column.kind in ("sample", "spp"):
            kinds.append(column.kind)
        elif not column.varies:
            kinds.append("")
        else:
            kinds.append("clip" if column.kind == "clip" else "sample")
    return kinds


def _fill(skeleton: str, group: Group, kinds: Sequence[str]) -> str:
    """The pattern: the skeleton with placeholders, and with numbers that are the same in all."""
    pieces, seen = skeleton.split("#"), dict[str, list[str]]()
    text = pieces[0]
    for index, (kind, piece) in enumerate(zip(kinds, pieces[1:], strict=True)):
        written = [numbers[index] for _, numbers in group]
        if not kind:
            text += written[0] if len(set(written)) == 1 else "*"
        elif kind in seen and seen[kind] != written:  # the same number with another padding
            text += "*"
        else:
            seen[kind] = written
            text += f"{{{kind}}}"
        text += piece
    return HALVES.sub(r"\1\2{half}", text)
