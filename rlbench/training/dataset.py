"""Training and validation clips: generated scenes, all scenes but one, or procedural clips."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rlbench.clips.header import FILE
from rlbench.errors import OptionError
from rlbench.registry.near_names import unknown_name
from rlbench.render.jobs.preset_clips import render_preset_clips
from rlbench.system import paths

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor

__all__ = [
    "QUICK_PREFIX",
    "QUICK_REMARK",
    "TrainingSplit",
    "count_unrendered",
    "select_split",
    "split_generated",
    "split_holdout",
    "split_quick",
]

QUICK_PREFIX = "procedural-"  # of the names of clips for a quick training
QUICK_CLIPS, QUICK_SIDE = 10, 160  # clips, and pixels; as large as those of the preset `train`
QUICK_REMARK = "quick: trained on procedural clips, to try the training, not for results"
ONE_CLIP_REMARK = "validated on the clip that it was trained on"
VALIDATION_SEEDS = (0, 14)  # of generated scenes, for runs that are not trained on generated ones


class TrainingSplit(NamedTuple):
    """Clip folders to train and to validate on; a clip is in both only if there is one alone."""

    train: list[Path]
    validation: list[Path]
    remark: str = ""  # what users of the weights should know, for their model card


def select_split(
    preset: str | None,
    seeds: tuple[int, ...] | None,
    held_out_scene: str | None,
    pool_kinds: Collection[str] | None = None,
    executor: Executor | None = None,
) -> TrainingSplit:
    """The clips that the options --preset, --seeds and --holdout select.

    Clips get the sample pools named in `pool_kinds`; `executor` renders missing clips. Raises
    OptionError if the options contradict each other, and as `generated` and `holdout` do.
    """
    if held_out_scene is None:
        return split_generated(preset or "train", seeds, pool_kinds, executor)
    if seeds is not None:
        raise OptionError(
            "--seeds applies to generated scenes only. With --holdout, training uses the other "
            "test scenes of a preset: omit --seeds or --holdout"
        )
    return split_holdout(held_out_scene, preset or "mini", pool_kinds, executor)


def split_quick(pool_kinds: Collection[str]) -> TrainingSplit:
    """Procedural clips, which need no rendering: seconds at first use. The last two validate.

    Raises OptionError for pools other than the path tracer's.
    """
    from rlbench.clips.procedural.clip import procedural_clip
    from rlbench.clips.procedural.folder import write_procedural_clip

    if others := sorted(set(pool_kinds) - {"path"}):
        raise OptionError(
            f"--quick trains on samples of the pool 'path', and a method needs '{others[0]}'. "
            "Train it without --quick"
        )
    version = procedural_clip().digest[:8]  # of the code that makes the clips
    folders = [
        paths.clips_folder() / f"quick-{version}" / f"{QUICK_PREFIX}{seed}"
        for seed in range(QUICK_CLIPS)
    ]
    for seed, folder in enumerate(folders):
        if not (folder / FILE).is_file():
            write_procedural_clip(folder, seed, QUICK_SIDE)
    return TrainingSplit(folders[:-2], folders[-2:], QUICK_REMARK)


def count_unrendered(preset: str, seeds: tuple[int, ...] | None) -> tuple[int, int]:
    """The number of training clips that were never rendered, and that of all; no test sets.

    Raises OptionError if the preset or a seed belongs to a test set, UnknownPresetError if there is
    no such preset.
    """
    from rlbench.render.jobs.render_clips import selected_names
    from rlbench.render.presets import get_preset

    _check_not_test_set(preset, seeds)
    names = selected_names(get_preset(preset), seeds=seeds)
    files = [paths.clips_folder() / preset / name / FILE for name in names]
    return sum(not file.is_file() for file in files), len(files)


def split_generated(
    preset: str,
    seeds: tuple[int, ...] | None = None,
    pool_kinds: Collection[str] | None = None,
    executor: Executor | None = None,
) -> TrainingSplit:
    """Generated scenes of a preset, or those of `seeds`; the first and the middle one validate.

    Missing clips are rendered. A single clip trains and validates, and the split says so. Raises
    OptionError if the preset or a seed belongs to a test set.
    """
    _check_not_test_set(preset, seeds)
    folders = render_preset_clips(
        None, preset, seeds=seeds, pool_kinds=pool_kinds, executor=executor
    )
    if len(folders) == 1:
        return TrainingSplit(folders, folders, ONE_CLIP_REMARK)
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
    scene: str,
    preset: str,
    pool_kinds: Collection[str] | None = None,
    executor: Executor | None = None,
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
        [name for name in scenes if name != scene],
        preset,
        pool_kinds=pool_kinds,
        executor=executor,
    )
    validate = render_preset_clips(
        None, "train", seeds=VALIDATION_SEEDS, pool_kinds=pool_kinds, executor=executor
    )
    return TrainingSplit(folders, validate)
