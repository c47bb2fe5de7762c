"""What was asked for on the command line, checked and turned into what the bench takes."""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from rlbench.errors import OptionError
from rlbench.render.jobs.preset_clips import render_preset_clips

if TYPE_CHECKING:
    import torch

    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.parallel.executor import Executor


def split(values: list[str]) -> list[str]:
    """Names given as `a,b`, as several options, or both."""
    return [part.strip() for value in values for part in value.split(",") if part.strip()]


def numbers(option: str, text: str, kind: type[Any]) -> tuple[Any, ...]:
    """Finite numbers >= 0 given as `1,2`, each once. Raises AskedError."""
    try:
        found = tuple(dict.fromkeys(kind(part) for part in split([text])))
    except ValueError:
        found = ()
    if not found or not all(math.isfinite(number) and number >= 0 for number in found):
        such = "0,1,2" if kind is int else "0.5,1,2"
        raise OptionError(f"{option} takes numbers such as {such} and was given '{text}'")
    return found


def device(name: str) -> torch.device:
    """A device that works here; `auto` is CUDA where there is one. Raises AskedError."""
    import torch

    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        found = torch.device(name)
        torch.empty(0, device=found)
    except (RuntimeError, AssertionError) as error:
        raise OptionError(f"--device {name} cannot be used here: {error}") from error
    return found


def clips(
    own: list[Path] | None,
    scenes: list[str] | None,
    preset: str,
    pool: str = "stored",
    engine: Executor | None = None,
    kinds: Collection[str] | None = None,
    takes: str | None = None,
) -> tuple[StoredSource, ...]:
    """The clips of one's own folders, or those of a preset, rendered if need be.

    `kinds` of sample pools are those that are wanted of a preset's, and `takes` of its scenes are
    `main` or `all`; None is all of the former, and the latter as in the preset.
    """
    from rlbench.benchmark.clip_sources import POOLS, open_source
    from rlbench.clips.stored import find_clips

    if pool not in POOLS:
        raise OptionError(f"--pool {pool}: samples are one of: {', '.join(POOLS)}")
    if own is None:
        made = render_preset_clips(
            split(scenes or []), preset, executor=engine, pool_kinds=kinds, takes=takes
        )
        return tuple(open_source(folder, pool) for folder in made)
    if takes is not None:
        raise OptionError(
            "--takes is of a preset's scenes; of --clips, --scenes names single clips"
        )
    found = [open_source(folder, pool) for place in own for folder in find_clips(place)]
    wanted = split(scenes or [])
    named = {clip: {clip.header.scene, clip.header.name} for clip in found}
    kept = tuple(clip for clip, names in named.items() if not wanted or names & set(wanted))
    if unknown := [name for name in wanted if not any(name in names for names in named.values())]:
        have = ", ".join(sorted({clip.header.scene for clip in found})) or "none"
        raise OptionError(f"--scenes {','.join(unknown)}: the clips given show: {have}")
    return kept


def methods(values: list[str], trained: bool = True) -> tuple[str, ...]:
    """Names that were asked for, as `registry.expand`; `all` goes on without broken families."""
    from rlbench import registry

    return tuple(registry.expand(split(values), trained, lambda words: typer.echo(words, err=True)))


def positive(option: str, number: float) -> float:
    """A number above zero. Raises AskedError."""
    if not number > 0:
        raise OptionError(f"{option} {number:g}: it has to be above 0")
    return number


def minutes(number: float | None) -> float:
    """What `--minutes` allows: without it, for ever. Raises AskedError."""
    return math.inf if number is None else positive("--minutes", number)


def weights(text: str | None) -> tuple[str, str | None]:
    """What `--weights NAME=FILE` calls them, or nothing, and the file. Raises AskedError."""
    from rlbench.benchmark.row_name import RESERVED_LABELS

    if text is None or text == "random":
        return "", text
    called, equals, file = text.partition("=")
    if not equals or Path(text).exists():
        called, file = "", text
    elif not re.fullmatch(r"[\w+-]+", called, re.ASCII):
        raise OptionError(f"--weights {text}: the name before = is of letters, digits, _, + and -")
    elif (kind := called.partition("-")[0]) in RESERVED_LABELS:
        raise OptionError(
            f"--weights {text}: METHOD@{kind} is what rows of another kind are called"
        )
    if not Path(file).is_file():
        raise OptionError(f"--weights {text}: there is no file {file}; 'rlbench train' makes one")
    return called, file


def seeds(text: str | None) -> tuple[int, ...] | None:
    """Seeds given as `0:48`, without 48, as `3,7`, or both; None if none. Raises AskedError."""
    if text is None:
        return None
    found: dict[int, None] = {}
    for part in split([text]) or [""]:
        first, colon, after = part.partition(":")
        numbers = range(0)
        if first.isdecimal() and (after.isdecimal() if colon else True):
            numbers = range(int(first), int(after) if colon else int(first) + 1)
        if not numbers:
            raise OptionError(
                f"--seeds takes a range such as 0:48, of which 48 is no part, or a list such as "
                f"3,7, and was given '{text}'"
            )
        found |= dict.fromkeys(numbers)
    return tuple(found)
