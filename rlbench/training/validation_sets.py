"""Validation sets: named by the user, or split off the clips that would be trained on."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rlbench.errors import OptionError
from rlbench.render.jobs.render_clips import render_preset_clips
from rlbench.render.presets import PRESETS
from rlbench.training.own_clips import find_own_clips

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor

__all__ = ["select_validation", "split_off_validation", "without_validation"]

INTERVAL = 8  # every so many clips, one validates


def select_validation(
    words: Iterable[str],
    pool_kinds: Collection[str] | None = None,
    executor: Executor | None = None,
) -> dict[str, list[Path]]:
    """Validation sets of `[NAME=]FOLDER` or `[NAME=]PRESET`; a name that is given twice is one set.

    A set is called after its preset, or after the last part of its folder. Missing clips of a
    preset are rendered. Raises OptionError for a preset that is reported, and for a folder with a
    clip of one, because a validation decides; ClipError for a folder without clips.
    """
    sets: dict[str, list[Path]] = {}
    for word in words:
        name, _, what = word.rpartition("=")
        if what in PRESETS and not Path(what).exists():
            _check_for_decisions(what)
            folders = render_preset_clips(None, what, pool_kinds=pool_kinds, executor=executor)
        else:
            folders = find_own_clips([what], "decide")
        known = sets.setdefault(name or Path(what).resolve().name, [])
        known += [folder for folder in folders if folder not in known]
    return sets


def split_off_validation(clips: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Clips to train on, and every eighth clip, but at least one, to validate on.

    A single clip is returned as both.

    >>> train, validation = split_off_validation([Path(f"{n}") for n in range(1, 18)])
    >>> len(train), [clip.name for clip in validation]
    (15, ['8', '16'])
    """
    if len(clips) == 1:
        return list(clips), list(clips)
    chosen = list(clips[INTERVAL - 1 :: INTERVAL] or clips[-1:])
    return [clip for clip in clips if clip not in chosen], chosen


def without_validation(clips: Sequence[Path], sets: Mapping[str, Sequence[Path]]) -> list[Path]:
    """The clips that are in none of the sets. Raises OptionError where that leaves none of some."""
    validating = {folder.resolve() for folders in sets.values() for folder in folders}
    train = [folder for folder in clips if folder.resolve() not in validating]
    if clips and not train:
        names = ", ".join(folder.name for folder in clips[:3]) + ", ..." * (len(clips) > 3)
        raise OptionError(
            f"all {len(clips)} clips to train on ({names}) validate, so none is left to train on. "
            "Name others with --validate"
        )
    return train


def _check_for_decisions(preset: str) -> None:
    if "decide" not in PRESETS[preset].uses:
        allowed = ", ".join(name for name, other in PRESETS.items() if "decide" in other.uses)
        raise OptionError(
            f"--validate {preset}: this is a reported test set, and a validation decides, for "
            f"example when to stop. Choose clips of your own, or: {allowed}"
        )
