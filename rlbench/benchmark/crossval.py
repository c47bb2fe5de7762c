"""Leave one scene out: train on all scenes but one, score on that one, for every scene in turn.

As Scardigli et al. 2023 evaluate. A training that is done is not done again, nor is a cell that is
in the results, so that a cross-validation that was killed goes on where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rlbench import registry
from rlbench.benchmark.cell_ids import CellIds
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import RunSummary, measure
from rlbench.cli import console
from rlbench.render.jobs import preset_clips
from rlbench.render.presets import PRESETS
from rlbench.training import dataset
from rlbench.training.dataset import TrainingSplit
from rlbench.training.runs import TrainingRuns


@dataclass(frozen=True)
class Fold:
    """One scene held out: what is trained on without it, and its clips."""

    scene: str
    chosen: TrainingSplit
    clips: tuple[StoredSource, ...]


def crossval(
    folds: Sequence[Fold],
    course: TrainingRuns,
    request: RunPlan,
    results: Path,
    tell: Callable[[str], None] = lambda words: None,
) -> RunSummary:
    """Rows of every method of the request on each fold's scene, by weights that never saw it.

    `request` says what is measured; its clips and weights are replaced. Methods that are trained
    here are called `NAME@crossval` in the results, and their rows say which weights were used;
    those that have nothing to train are measured as they are, under their own names.
    """
    whose = {name: variant_to_train(name) for name in request.methods}
    course.check([name for name in whose.values() if name])
    done = RunSummary()
    for place, fold in enumerate(folds):
        for name, teacher in whose.items():
            tell(f"fold {place + 1} of {len(folds)}: {name} without {fold.scene}")
            asked = replace(request, methods=(name,), clips=fold.clips)
            if teacher:
                weights = course.train(teacher, fold.chosen, fold.scene)
                asked = replace(asked, weights=str(weights), held_out_scene=fold.scene)
            with console.progress(asked) as bar:
                more = measure(asked, results, bar.tell, on_timing=bar.timed)
            done = replace(
                done,
                measured=done.measured + more.measured,
                skipped=done.skipped + more.skipped,
                cached=done.cached + more.cached,
                replaced=done.replaced + more.replaced,
            )
    return done


def folds(preset: str, scenes: Sequence[str], names: Sequence[str]) -> list[Fold]:
    """A fold for each scene of a preset, or of `scenes`; clips that are missing are rendered now.

    Those that are trained on have the sample pools that the methods `names` buy from. Raises
    AskedError where the preset has no such scene.
    """
    kinds = {registry.variant(name).traits.pool for name in names}
    known = PRESETS[preset].scenes if preset in PRESETS else ()
    return [
        Fold(
            scene,
            dataset.holdout(scene, preset, kinds),
            tuple(
                StoredSource(folder)
                for folder in preset_clips.rendered([scene], preset, kinds=kinds)
            ),
        )
        for scene in scenes or known or ["any"]
    ]


def variant_to_train(name: str) -> str:
    """The method whose training makes the weights of `name`: its own; empty if there is none."""
    row = registry.variant(name)
    family = name.partition("/")[0]
    borrowed = f"{family}/{row.weights_from}" if row.weights_from else family
    whose = name if row.weights_from is None else borrowed
    return whose if registry.is_trainable(whose) else ""


def row_names(request: RunPlan) -> list[str]:
    """What the methods of a request are called in the results of a cross-validation."""
    names = CellIds(replace(request, held_out_scene="one"))
    return [names.method(name) if variant_to_train(name) else name for name in request.methods]
