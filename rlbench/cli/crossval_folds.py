"""Cross-validation: train on all scenes but one, score on that one, for each scene in turn.

The protocol of Scardigli et al. 2023. Finished trainings and measured cells are not repeated, so a
killed cross-validation resumes where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from rlbench import registry
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.run_plan import RunPlan, row_name
from rlbench.benchmark.runner import ProgressCallbacks, RunSummary, measure
from rlbench.cli.methods import pool_kinds
from rlbench.clips.presets import find_preset
from rlbench.clips.rendering import render_preset_clips
from rlbench.training import dataset
from rlbench.training.dataset import TrainingSplit
from rlbench.training.loop import TrainingRuns

ProgressBar = Callable[[RunPlan], AbstractContextManager[ProgressCallbacks]]


@dataclass(frozen=True)
class Fold:
    """One held-out scene: the clips to train on without it, and its own clips."""

    scene: str
    split: TrainingSplit
    clips: tuple[StoredSource, ...]


def crossval(
    folds: Sequence[Fold],
    runs: TrainingRuns,
    plan: RunPlan,
    results: Path,
    on_fold: Callable[[str], None] = lambda message: None,
    progress_bar: ProgressBar = lambda plan: nullcontext(ProgressCallbacks()),
) -> RunSummary:
    """Measure every method of `plan` on each fold's scene, with weights trained without it.

    The clips and weights of `plan` are replaced. Rows of methods that are trained here are called
    `NAME@crossval`, and their `weights_hash` names the held-out scene; methods without anything to
    train are measured under their own names. `on_fold` is called with a message before each method
    of a fold; `progress_bar` opens a progress bar over the cells of one of these plans.
    """
    trained = {name: variant_to_train(name) for name in plan.methods}
    runs.check([name for name in trained.values() if name])
    summary = RunSummary()
    for index, fold in enumerate(folds, 1):
        for name, variant in trained.items():
            on_fold(f"fold {index} of {len(folds)}: {name} without {fold.scene}")
            fold_plan = replace(plan, methods=(name,), clips=fold.clips)
            if variant:
                weights = runs.train(variant, fold.split, fold.scene)
                fold_plan = replace(fold_plan, weights=str(weights), held_out_scene=fold.scene)
            with progress_bar(fold_plan) as bar:
                summary += measure(fold_plan, results, bar.on_cell, on_timing=bar.on_timing)
    return summary


def folds(preset: str, scenes: Sequence[str], names: Sequence[str]) -> list[Fold]:
    """One fold for each of `scenes`, or for each scene of the preset; renders missing clips.

    Training clips have the sample pools that the methods `names` draw from. Raises OptionError if
    the preset lacks one of the scenes.
    """
    pools = pool_kinds(names)
    known = find_preset(preset)
    preset_scenes = known.scenes if known else ()
    return [
        Fold(
            scene,
            dataset.select_split(preset, None, scene, pools),
            tuple(
                StoredSource(folder)
                for folder in render_preset_clips([scene], preset, pool_kinds=pools)
            ),
        )
        for scene in scenes or preset_scenes or ["any"]
    ]


def variant_to_train(name: str) -> str:
    """The method whose training makes the weights of `name`: often itself; empty if none."""
    method = registry.get_variant(name).weights_from or name
    return method if registry.is_trainable(method) else ""


def row_names(plan: RunPlan) -> list[str]:
    """Names of the rows of a cross-validation of `plan`."""
    held_out = replace(plan, held_out_scene="any")
    return [row_name(held_out, name) if variant_to_train(name) else name for name in plan.methods]
