"""A user's own clips: which folders are named, which clips are refused, and why."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from glob import glob, has_magic
from pathlib import Path

from rlbench.clips.compatibility import incompatibility
from rlbench.clips.header import ClipError, Header
from rlbench.clips.stored import StoredClip, find_all_clips, open_clip, read_header
from rlbench.errors import OptionError
from rlbench.family import Traits
from rlbench.render.presets import PresetUse, is_clip_for
from rlbench.training.batches import TRAINING_INPUTS, BatchError

__all__ = ["check_clips", "describe_small_pools", "find_own_clips"]

MAX_LISTED = 5  # clips in a message
REFUSALS: Mapping[PresetUse, str] = {
    "train": "so methods must not be trained on it",
    "decide": "so it must not validate, because a validation decides",
}


def find_own_clips(folders: Iterable[str | Path], use: PresetUse = "train") -> list[Path]:
    """The clip folders at or directly below each folder or shell-style pattern, each once.

    Raises ClipError where there is none, and OptionError for a clip of a preset that is not for
    `use`, such as a test clip to train on.
    """
    found = find_all_clips(path for folder in folders for path in _expand(str(folder)))
    clips = list({folder.resolve(): folder for folder in found}.values())
    for folder in clips:
        header = read_header(folder)
        if "no reference" in header.limitations:
            raise ClipError(
                f"clip '{header.name}' in {folder} has frames without a reference, and trainings "
                "compare with it. Leave the clip out"
            )
        if not is_clip_for(use, header.preset, header.scene, header.name):
            raise OptionError(
                f"clip '{header.name}' in {folder} belongs to preset '{header.preset}', which is "
                f"scored, {REFUSALS[use]}. Leave it out of the folders, and measure it by 'rlbench "
                f"run --clips {folder}'"
            )
    return clips


def check_clips(
    method: str, traits: Traits, clips: Sequence[Path], crop: int, budgets: Sequence[float]
) -> None:
    """Raise BatchError, naming each clip that cannot train a method with these traits, and why.

    A clip has to have all files, the buffers and the sample pool that the method needs, `crop`
    pixels on each side, and samples for the least budget that the method supports. `crop` is 0 for
    clips that only validate. `budgets` are those of the training, in samples per pixel; a larger
    one than a clip has samples is limited to them.
    """
    problems = [
        f"{folder.name}: {reason}"
        for folder in clips
        if (reason := _why_not(folder, traits, crop, budgets))
    ]
    if problems:
        more = len(problems) - MAX_LISTED
        tail = [f"and {more} more"] if more > 0 else []
        raise BatchError(
            f"'{method}' cannot use {len(problems)} of {len(clips)} clips. Correct them or leave "
            f"them out: {'; '.join([*problems[:MAX_LISTED], *tail])}"
        )


def describe_small_pools(clips: Sequence[StoredClip], budgets: Sequence[float]) -> str:
    """Which clips store fewer samples than the largest budget, in one line; empty if none does."""
    most = max(budgets, default=0.0)
    small = [f"{clip.name} {clip.max_samples}" for clip in clips if clip.max_samples < most]
    if not small:
        return ""
    more = f" and {len(small) - MAX_LISTED} more" if len(small) > MAX_LISTED else ""
    return (
        f"{len(small)} of {len(clips)} clips store fewer samples per pixel than the largest budget "
        f"of {most:g} ({', '.join(small[:MAX_LISTED])}{more}): budgets above are limited to them"
    )


def _expand(word: str) -> list[Path]:
    """The folders that a word names: the folder itself, or all that match it as a pattern."""
    path = Path(word).expanduser()
    if path.exists() or not has_magic(word):
        return [path]
    if folders := [Path(match) for match in sorted(glob(str(path))) if Path(match).is_dir()]:
        return folders
    raise ClipError(f"no folder matches '{word}'. Name a folder that holds clips")


def _why_not(folder: Path, traits: Traits, crop: int, budgets: Sequence[float]) -> str:
    """Why a clip cannot be used, with a remedy; empty if it can."""
    try:
        header = read_header(folder)
        needed = traits.inputs | (TRAINING_INPUTS if crop else frozenset())
        for spp in budgets or (max(1.0, traits.spp_range[0]),):
            spp = min(spp, float(header.pool_spp))
            if reason := incompatibility(header, traits, spp):
                return reason
        if min(header.height, header.width) < crop:
            return _too_small(header, crop)
        open_clip(folder, needed, pool=traits.pool)
    except ClipError as error:
        hint = "; a training needs a reference of every frame" * ("reference" in str(error))
        return f"{error}{hint}"
    return ""


def _too_small(header: Header, crop: int) -> str:
    side = min(header.height, header.width)
    return (
        f"has {header.height} x {header.width} pixels, fewer than crops of {crop} x {crop}; "
        f"choose --crop {side} or less"
    )
