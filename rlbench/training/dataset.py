"""Which clips a training sees and which validate it: generated ones, or all scenes but one."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from rlbench.errors import OptionError
from rlbench.render.jobs.preset_clips import rendered

VALIDATING = (0, 14)  # seeds of generated scenes, where it is not these that are trained on


class TrainingSplit(NamedTuple):
    """Clip folders; no clip is in both."""

    train: list[Path]
    validate: list[Path]


NONE = TrainingSplit([], [])  # of a training in which nothing learns


def chosen(
    preset: str | None,
    seeds: tuple[int, ...] | None,
    without: str | None,
    kinds: Collection[str] | None = None,
) -> TrainingSplit:
    """What --preset, --seeds and --holdout ask for together, with those kinds of sample pools.

    Raises AskedError.
    """
    if without is None:
        return generated(preset or "train", seeds, kinds)
    if seeds is not None:
        raise OptionError("--seeds are of generated scenes; --holdout trains on those scored")
    return holdout(without, preset or "mini", kinds)


def generated(
    preset: str, seeds: tuple[int, ...] | None = None, kinds: Collection[str] | None = None
) -> TrainingSplit:
    """Generated scenes, a preset's or those of some seeds; the first and the middle validate.

    Clips that are missing are rendered now. Raises AskedError where the preset or one of the seeds
    is scored, or where there are too few clips to keep one for validation.
    """
    from rlbench.render.presets import PRESETS

    if seeds is not None and len(seeds) < 2:
        raise OptionError(f"--seeds {seeds[0]} is one clip; at least 2 are needed, 1 validates")
    if seeds is None and preset in PRESETS and PRESETS[preset].is_test_set:
        fit = ", ".join(name for name, plan in PRESETS.items() if not plan.is_test_set)
        shown = ", ".join(PRESETS[preset].scenes) or "generated ones"
        raise OptionError(
            f"preset '{preset}' has scenes that methods are scored on ({shown}), so "
            f"nothing may be trained on it; there is: {fit}"
        )
    for name, plan in PRESETS.items():
        if plan.is_test_set and (kept := sorted(set(seeds or ()) & set(plan.seeds))):
            raise OptionError(
                f"--seeds: methods are scored on {', '.join(map(str, kept))} (preset '{name}'), so "
                f"nothing may be trained on them; free are those that are not among "
                f"{min(plan.seeds)} to {max(plan.seeds)}"
            )
    folders = rendered(None, preset, chosen=seeds, kinds=kinds)
    validate = folders[:: max(len(folders) // 2, 2)][:2]
    return TrainingSplit([folder for folder in folders if folder not in validate], validate)


def holdout(scene: str, preset: str, kinds: Collection[str] | None = None) -> TrainingSplit:
    """All scenes of a preset but one, which is to be scored: leave-one-scene-out.

    As Scardigli et al. 2023 evaluate. Two generated scenes validate, so that nothing of the
    scene held out decides anything. Clips that are missing are rendered now. Raises AskedError
    where the preset has no such scene.
    """
    from rlbench.render.presets import PRESETS

    known = PRESETS[preset].scenes if preset in PRESETS else ()
    if known and scene not in known:
        raise OptionError(
            f"no scene {scene} to leave out: preset '{preset}' has: {', '.join(known)}"
        )
    if not known:
        fit = ", ".join(name for name, plan in PRESETS.items() if plan.scenes)
        raise OptionError(f"--holdout takes a preset with scenes that are scored: --preset {fit}")
    folders = rendered([name for name in known if name != scene], preset, kinds=kinds)
    return TrainingSplit(folders, rendered(None, "train", chosen=VALIDATING, kinds=kinds))
