"""Training and validation clips: of presets, of the user, all scenes but one, or procedural.

Which clips are selected, which are refused, and why.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from glob import glob, has_magic
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rlbench.clips.compatibility import incompatibility
from rlbench.clips.header import FILE, ClipError, read_header
from rlbench.clips.presets import (
    PRESETS,
    PresetUse,
    find_preset,
    get_preset,
    is_clip_for,
)
from rlbench.clips.procedural.folder import QUICK_PREFIX, QUICK_REMARK
from rlbench.clips.rendering import render_preset_clips
from rlbench.clips.stored import StoredClip, find_all_clips, open_clip
from rlbench.errors import OptionError
from rlbench.family import Traits
from rlbench.registry.near_names import unknown_name
from rlbench.system import paths
from rlbench.training.batches import TRAINING_INPUTS, BatchError
from rlbench.training.render_ahead import FurtherClips

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor

Render = Callable[..., list[Path]]  # `render_preset_clips`, perhaps with some arguments given

QUICK_CLIPS, QUICK_SIDE = 10, 160  # clips, and pixels; as large as those of the preset `train`
ONE_CLIP_REMARK = "validated on the clip that it was trained on"
VALIDATION_SEEDS = (0, 14)  # of generated scenes, for runs that are not trained on generated ones
OWN = "clips"  # name of the validation set that is split off the user's own clips
MAX_LISTED = 5  # clips in a message
INTERVAL = 8  # every so many clips, one validates
REFUSALS: Mapping[PresetUse, str] = {
    "train": "so methods must not be trained on it",
    "decide": "so it must not validate, because a validation decides",
}


class TrainingSplit(NamedTuple):
    """Clip folders to train and to validate on; a clip is in both only if there is one alone."""

    train: Sequence[Path]
    validation: Mapping[str, Sequence[Path]]  # sets of clips by name, each with a mean of its own
    remark: str = ""  # what users of the weights should know, for their model card
    mixed_in: Sequence[Path] = ()  # clips that are drawn with the share `TrainingConfig.mix`
    further: FurtherClips | None = None  # that replace those of `train`, one after the other

    @property
    def summary(self) -> str:
        """One line: how many clips train, and which ones validate."""
        count = len(self.train) + len(self.mixed_in)
        noun = "clip trains" if count == 1 else "clips train"
        if self.remark == ONE_CLIP_REMARK:
            return f"1 clip trains and validates: {self.train[0].name}"
        parts = []
        for name, folders in self.validation.items():
            more = ", ..." if len(folders) > MAX_LISTED else ""
            clips = ", ".join(folder.name for folder in folders[:MAX_LISTED])
            parts.append(f"{name}, {len(folders)} ({clips}{more})")
        return f"{count} {noun}; these validate and are not trained on: {'; '.join(parts)}"


def select_split(
    preset: str | None,
    seeds: tuple[int, ...] | None,
    held_out_scene: str | None,
    pool_kinds: Collection[str] | None = None,
    executor: Executor | None = None,
    clips: Sequence[str] = (),
    validate: Sequence[str] = (),
    render_ahead: int = 0,
) -> TrainingSplit:
    """The clips that the options --preset, --seeds, --holdout, --clips and --validate select.

    `preset` may name several, separated by commas. `clips` are folders or shell-style patterns of
    a user's clips, or presets, which train alone, or are mixed in where a preset or seeds are given
    too.
    `validate` names validation sets as `select_validation` does; otherwise the first and the middle
    clip of each preset validate, and every eighth of the user's. Clips get the sample pools named
    in `pool_kinds`; `executor` renders missing clips. `render_ahead` clips of the presets
    are rendered while it trains.

    Raises OptionError if the options contradict each other, and as `split_generated`,
    `split_holdout`, `find_own_clips`, `select_validation` and `FurtherClips` do.
    """
    further = FurtherClips(_names(preset), render_ahead) if render_ahead else None
    render = partial(render_preset_clips, pool_kinds=pool_kinds, executor=executor)
    if held_out_scene is None:
        return _select(preset, seeds, render, clips, validate)._replace(further=further)
    if further:
        raise OptionError("--render-ahead renders generated scenes, and --holdout trains on others")
    if seeds is not None:
        raise OptionError(
            "--seeds applies to generated scenes only. With --holdout, training uses the other "
            "test scenes of a preset: omit --seeds or --holdout"
        )
    if clips or validate:
        option = "--clips" if clips else "--validate"
        raise OptionError(
            f"--holdout trains on test scenes of a preset, and {option} names other clips. Omit "
            "one of them"
        )
    return split_holdout(held_out_scene, preset or "mini", render)


def _select(
    preset: str | None,
    seeds: tuple[int, ...] | None,
    render: Render,
    clips: Sequence[str],
    validate: Sequence[str],
) -> TrainingSplit:
    """The split of presets, of the user's clips, or of both."""
    names = _names(preset)
    if seeds is not None and len(names) > 1:
        raise OptionError(f"--seeds applies to one preset, and --preset names {', '.join(names)}")
    if clips and preset is None and seeds is None:
        names = ()
    found = (folder for word in clips for folder in _find_clips(word, "train", render))
    own = list({folder.resolve(): folder for folder in found}.values())
    for name in names:
        _check_not_test_set(name, seeds)
    sets: dict[str, Sequence[Path]] = dict(select_validation(validate, render))
    if validate:  # all other clips train
        rendered = [path for name in names for path in render(None, name, seeds=seeds)]
        return _join(without_validation(rendered, sets), without_validation(own, sets), sets)
    train: list[Path] = []
    remark = ""
    for name in names:
        split = split_generated(name, seeds, render)
        train, remark = [*train, *split.train], remark or split.remark
        sets |= split.validation
    if own:
        remark = remark or ONE_CLIP_REMARK * (len(own) == 1)
        own, sets[OWN] = split_off_validation(own)
    return _join(train, own, sets, remark)


def _names(presets: str | None) -> tuple[str, ...]:
    return tuple(filter(None, (name.strip() for name in (presets or "train").split(","))))


def _join(
    rendered: list[Path], own: list[Path], sets: Mapping[str, Sequence[Path]], remark: str = ""
) -> TrainingSplit:
    """A split whose own clips are mixed in, or train alone where none is rendered."""
    return TrainingSplit(rendered or own, sets, remark, own if rendered else [])


def select_validation(
    words: Iterable[str], render: Render = render_preset_clips
) -> dict[str, list[Path]]:
    """Validation sets of `[NAME=]FOLDER` or `[NAME=]PRESET`; a name that is given twice is one set.

    A set is called after its preset, or after the last part of its folder. Missing clips of a
    preset are rendered. Raises OptionError for a preset that is reported, and for a folder with a
    clip of one, because a validation decides; ClipError for a folder without clips.
    """
    sets: dict[str, list[Path]] = {}
    for word in words:
        name, _, what = word.rpartition("=")
        known = sets.setdefault(name or Path(what).resolve().name, [])
        known += [folder for folder in _find_clips(what, "decide", render) if folder not in known]
    return sets


def _find_clips(word: str, use: PresetUse, render: Render) -> Sequence[Path]:
    """The clips of a preset, or in a folder or pattern where there is no preset of that name."""
    if not find_preset(word) or Path(word).exists():
        return find_own_clips([word], use)
    if use == "decide":
        _check_for_decisions(word)
    else:
        _check_not_test_set(word, None)
    return render(None, word)


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
    if "decide" not in get_preset(preset).uses:
        allowed = ", ".join(name for name, other in PRESETS.items() if "decide" in other.uses)
        raise OptionError(
            f"--validate {preset}: this is a reported test set, and a validation decides, for "
            f"example when to stop. Choose clips of your own, or: {allowed}"
        )


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
    return TrainingSplit(folders[:-2], {"quick": folders[-2:]}, QUICK_REMARK)


def count_unrendered(preset: str, seeds: tuple[int, ...] | None) -> tuple[int, int]:
    """The number of training clips that were never rendered, and that of all; no test sets.

    Raises OptionError if the preset or a seed belongs to a test set, UnknownPresetError if there is
    no such preset.
    """
    _check_not_test_set(preset, seeds)
    names = get_preset(preset).clip_names(seeds=seeds)
    files = [paths.clips_folder() / preset / name / FILE for name in names]
    return sum(not file.is_file() for file in files), len(files)


def split_generated(
    preset: str, seeds: tuple[int, ...] | None = None, render: Render = render_preset_clips
) -> TrainingSplit:
    """Generated scenes of a preset, or those of `seeds`; the first and the middle one validate.

    Missing clips are rendered. A single clip trains and validates, and the split says so. Raises
    OptionError if the preset or a seed belongs to a test set.
    """
    _check_not_test_set(preset, seeds)
    folders = render(None, preset, seeds=seeds)
    if len(folders) == 1:
        return TrainingSplit(folders, {preset: folders}, ONE_CLIP_REMARK)
    validate = folders[:: max(len(folders) // 2, 2)][:2]
    train = [folder for folder in folders if folder not in validate]
    return TrainingSplit(train, {preset: validate})


def _check_not_test_set(preset: str, seeds: tuple[int, ...] | None) -> None:
    known = find_preset(preset)
    if seeds is None and known and known.is_test_set:
        allowed = ", ".join(name for name, other in PRESETS.items() if not other.is_test_set)
        scenes = ", ".join(known.scenes) or "generated scenes"
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


def split_holdout(scene: str, preset: str, render: Render = render_preset_clips) -> TrainingSplit:
    """All scenes of a preset except one, which is the test scene: leave-one-scene-out.

    The protocol of Scardigli et al. 2023. Two generated scenes validate, so that the held-out scene
    influences no decision. Missing clips are rendered. Raises OptionError if the preset has no such
    scene.
    """
    known = find_preset(preset)
    scenes = known.scenes if known else ()
    if not scenes:
        allowed = ", ".join(name for name, other in PRESETS.items() if other.scenes)
        raise OptionError(
            f"holding out a scene needs a preset with named scenes, and '{preset}' has none. "
            f"Choose --preset {allowed}"
        )
    if scene not in scenes:
        problem = f"no scene '{scene}' to hold out"
        raise OptionError(unknown_name(problem, scene, scenes, f": preset '{preset}' has"))
    folders = render([name for name in scenes if name != scene], preset)
    validate = render(None, "train", seeds=VALIDATION_SEEDS)
    return TrainingSplit(folders, {"train": validate})


def find_own_clips(folders: Iterable[str | Path], use: PresetUse = "train") -> list[Path]:
    """The clip folders at or directly below each folder or shell-style pattern, each once.

    Raises ClipError where there is none, and for one that has frames without a reference;
    OptionError for a clip of a preset that is not for `use`, such as a test clip to train on.
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
            side = min(header.height, header.width)
            return (
                f"has {header.height} x {header.width} pixels, fewer than crops of {crop} x "
                f"{crop}; choose --crop {side} or less"
            )
        open_clip(folder, needed, pool=traits.pool)
    except ClipError as error:
        hint = "; a training needs a reference of every frame" * ("reference" in str(error))
        return f"{error}{hint}"
    return ""
