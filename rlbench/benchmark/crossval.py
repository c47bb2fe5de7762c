"""Leave one scene out: train on all scenes but one, score on that one, for every scene in turn.

As Scardigli et al. 2023 evaluate. A training that is done is not done again, nor is a cell that is
in the results, so that a cross-validation that was killed goes on where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rlbench.benchmark.cell_ids import Names
from rlbench.benchmark.clip_sources import Stored
from rlbench.benchmark.run_plan import Request
from rlbench.benchmark.runner import Done, measure
from rlbench.cli import console as show
from rlbench.registry import lookup as registry
from rlbench.render.jobs import preset_clips
from rlbench.render.presets import PRESETS
from rlbench.training import dataset as trainset
from rlbench.training.dataset import TrainSet
from rlbench.training.runs import Course


@dataclass(frozen=True)
class Fold:
    """One scene held out: what is trained on without it, and its clips."""

    scene: str
    chosen: TrainSet
    clips: tuple[Stored, ...]


def crossval(
    folds: Sequence[Fold],
    course: Course,
    request: Request,
    results: Path,
    tell: Callable[[str], None] = lambda words: None,
) -> Done:
    """Rows of every method of the request on each fold's scene, by weights that never saw it.

    `request` says what is measured; its clips and weights are replaced. Methods that are trained
    here are called `NAME@crossval` in the results, and their rows say which weights were used;
    those that have nothing to train are measured as they are, under their own names.
    """
    whose = {name: taught(name) for name in request.methods}
    course.check([name for name in whose.values() if name])
    done = Done()
    for place, fold in enumerate(folds):
        for name, teacher in whose.items():
            tell(f"fold {place + 1} of {len(folds)}: {name} without {fold.scene}")
            asked = replace(request, methods=(name,), clips=fold.clips)
            if teacher:
                weights = course.train(teacher, fold.chosen, fold.scene)
                asked = replace(asked, weights=str(weights), without=fold.scene)
            with show.progress(asked) as bar:
                more = measure(asked, results, bar.tell, timed=bar.timed)
            done = replace(
                done,
                measured=done.measured + more.measured,
                refused=done.refused + more.refused,
                known=done.known + more.known,
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
            trainset.holdout(scene, preset, kinds),
            tuple(Stored(folder) for folder in preset_clips.rendered([scene], preset, kinds=kinds)),
        )
        for scene in scenes or known or ["any"]
    ]


def taught(name: str) -> str:
    """The method whose training makes the weights of `name`: its own; empty if there is none."""
    row = registry.variant(name)
    family = name.partition("/")[0]
    borrowed = f"{family}/{row.borrows}" if row.borrows else family
    whose = name if row.borrows is None else borrowed
    return whose if registry.learns(whose) else ""


def told(request: Request) -> list[str]:
    """What the methods of a request are called in the results of a cross-validation."""
    names = Names(replace(request, without="one"))
    return [names.method(name) if taught(name) else name for name in request.methods]
