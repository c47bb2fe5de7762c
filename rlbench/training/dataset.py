"""Training and validation clips: generated scenes, or all scenes of a preset except one."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from rlbench.errors import OptionError
from rlbench.registry.near_names import unknown_name
from rlbench.render.jobs.preset_clips import render_preset_clips

__all__ = ["TrainingSplit", "select_split", "split_generated", "split_holdout"]

VALIDATION_SEEDS = (0, 14)  # of generated scenes, for runs that are not trained on generated ones


class TrainingSplit(NamedTuple):
    """Clip folders to train and to validate on; no clip is in both."""

    train: list[Path]
    validation: list[Path]


def select_split(
    preset: str | None,
    seeds: tuple[int, ...] | None,
    held_out_scene: str | None,
    pool_kinds: Collection[str] | None = None,
) -> TrainingSplit:
    """The clips that the options --preset, --seeds and --holdout select.

    Clips get the sample pools named in `pool_kinds`; missing clips are rendered. Raises
    OptionError if the options contradict each other, and as `generated` and `holdout` do.
    """
    if held_out_scene is None:
        return split_generated(preset or "train", seeds, pool_kinds)
    if seeds is not None:
        raise OptionError(
            "--seeds applies to generated scenes only. With --holdout, training uses the other "
            "test scenes of a preset: omit --seeds or --holdout"
        )
    return split_holdout(held_out_scene, preset or "mini", pool_kinds)


def split_generated(
    preset: str,
    seeds: tuple[int, ...] | None = None,
    pool_kinds: Collection[str] | None = None,
) -> TrainingSplit:
    """Generated scenes of a preset, or those of `seeds`; the first and the middle one validate.

    Missing clips are rendered. Raises OptionError if the preset or a seed belongs to a test set, or
    if there are too few clips to keep one for validation.
    """
    if seeds is not None and len(seeds) < 2:
        raise OptionError(
            f"--seeds {seeds[0]} gives one clip. Training needs at least 2 clips, because one of "
            "them validates"
        )
    _check_not_test_set(preset, seeds)
    folders = render_preset_clips(None, preset, seeds=seeds, pool_kinds=pool_kinds)
    validate = folders[:: max(len(folders) // 2, 2)][:2]
    return TrainingSplit([folder for folder in folders if folder not in validate], validate)


def _check_not_test_set(preset: str, seeds: tuple[int, ...] | None) -> None:
    from rlbench.render.presets import PRESETS

    if seeds is None and preset in PRESETS and PRESETS[preset].is_test_set:
        allowed = ", ".join(name for name, other in PRESETS.items() if not other.is_test_set)
        scenes = ", ".join(PRESETS[preset].scenes) or "generated scenes"
        raise OptionError(
            f"preset '{preset}' is a test set ({scenes}), so methods must not be trained on it. "
            f"Choose: {allowed}"
        )
    for name, other in PRESETS.items():
        shared = sorted(set(seeds or ()) & set(other.seeds)) if other.is_test_set else []
        if shared:
            raise OptionError(
                f"--seeds {', '.join(map(str, shared))}: these belong to test set '{name}', so "
                "methods must not be trained on them. Choose seeds outside "
                f"{min(other.seeds)} to {max(other.seeds)}"
            )


def split_holdout(
    scene: str, preset: str, pool_kinds: Collection[str] | None = None
) -> TrainingSplit:
    """All scenes of a preset except one, which is the test scene: leave-one-scene-out.

    The protocol of Scardigli et al. 2023. Two generated scenes validate, so that the held-out scene
    influences no decision. Missing clips are rendered. Raises OptionError if the preset has no such
    scene.
    """
    from rlbench.render.presets import PRESETS

    scenes = PRESETS[preset].scenes if preset in PRESETS else ()
    if not scenes:
        allowed = ", ".join(name for name, other in PRESETS.items() if other.scenes)
        raise OptionError(
            f"holding out a scene needs a preset with named scenes, and '{preset}' has none. "
            f"Choose --preset {allowed}"
        )
    if scene not in scenes:
        problem = f"no scene '{scene}' to hold out"
        raise OptionError(unknown_name(problem, scene, scenes, f": preset '{preset}' has"))
    folders = render_preset_clips(
        [name for name in scenes if name != scene], preset, pool_kinds=pool_kinds
    )
    validate = render_preset_clips(None, "train", seeds=VALIDATION_SEEDS, pool_kinds=pool_kinds)
    return TrainingSplit(folders, validate)
