"""The clips of the commands that train: rendered, the user's own, or refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rlbench.cli import arguments
from rlbench.cli.arguments import Seeds
from rlbench.cli.verbosity import note
from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor
    from rlbench.training.dataset import TrainingSplit

__all__ = ["announce_rendering", "mix_share", "pool_kinds", "refuse_other_clips", "select_split"]

DEFAULT_MIX = 0.5


def select_split(
    names: list[str],
    preset: str | None,
    seeds: Seeds | None,
    holdout: str | None,
    clips: list[str] | None = None,
    validate: list[str] | None = None,
    executor: Executor | None = None,
) -> TrainingSplit:
    """Clips for the training of these methods; renders those that are missing."""
    from rlbench.training import dataset

    return dataset.select_split(
        preset,
        seeds,
        holdout,
        pool_kinds(names),
        executor,
        arguments.split_names(clips),
        arguments.split_names(validate),
    )


def mix_share(
    mix: float | None, preset: str | None, seeds: Seeds | None, clips: list[str] | None
) -> float:
    """The share of crops from --clips that are mixed in; 0 without clips of both kinds."""
    is_mixed = bool(clips) and (preset is not None or seeds is not None)
    if mix is not None and not is_mixed:
        raise OptionError(
            "--mix is the share of crops from --clips, the others are from --preset. Give both of "
            "them, or omit --mix"
        )
    return (mix or DEFAULT_MIX) if is_mixed else 0.0


def pool_kinds(names: list[str]) -> set[str]:
    """The kinds of sample pool that the methods draw from."""
    from rlbench import registry

    return {registry.get_variant(name).traits.pool for name in names}


def announce_rendering(preset: str | None, seeds: Seeds | None, clips: list[str] | None) -> None:
    """Say how many training clips are rendered before the training begins."""
    from rlbench.render.presets import PRESETS
    from rlbench.training import dataset

    if clips and preset is None and seeds is None:
        return
    names = arguments.split_names([preset or "train"])
    # an error that suggests the nearest name follows for others
    counts = [dataset.count_unrendered(name, seeds) for name in names if name in PRESETS]
    missing, total = (sum(numbers) for numbers in zip((0, 0), *counts, strict=True))
    if missing:
        note(
            f"{missing} of {total} training clips have to be rendered first. --quick tries the "
            "training on clips that need no rendering"
        )


def refuse_other_clips(*values: object) -> None:
    """Raise OptionError for options that choose clips, which --quick has of its own."""
    names = ("--preset", "--seeds", "--holdout", "--clips", "--validate")
    chosen = dict(zip(names, values, strict=True))
    if given := [option for option, value in chosen.items() if value is not None]:
        raise OptionError(
            f"--quick trains on clips of its own, and {given[0]} chooses others. Omit one of them"
        )
