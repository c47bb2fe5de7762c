"""What a command reads of the results: rows by method, scene and budget, and the kept images."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rlbench.api import select_methods
from rlbench.cli.arguments import split_names
from rlbench.errors import OptionError
from rlbench.registry.near_names import unknown_name

if TYPE_CHECKING:
    import pandas as pd

    from rlbench.benchmark.cell_images import KeptImages
    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.benchmark.shown_clips import ShownClips


def read_rows(
    results: Path,
    methods: list[str] | None = None,
    scenes: list[str] | None = None,
    spp: Collection[float] | None = None,
) -> pd.DataFrame:
    """The rows of a results folder that the options --methods, --scenes and --spp select.

    Raises OptionError for a name or a budget without rows, and PluginError for a method that is
    neither in the results nor installed.
    """
    from rlbench.benchmark.results import read

    rows = read(results)
    if names := split_names(methods):
        rows = select_methods(rows, names, results)
    if names := split_names(scenes):
        available = {*rows["scene"], *rows["clip"]}
        if unknown := [name for name in names if name not in available]:
            problem = f"--scenes {','.join(unknown)}: {results} has no rows of it"
            raise OptionError(unknown_name(problem, unknown[0], sorted(available)))
        rows = rows[rows["scene"].isin(names) | rows["clip"].isin(names)]
    if spp:
        budgets = set(rows["target_spp"])
        if missing := [budget for budget in spp if budget not in budgets]:
            raise OptionError(
                f"--spp {_join(missing, ',')}: {results} has no rows of it; available: "
                f"{_join(budgets)}"
            )
        rows = rows[rows["target_spp"].isin(list(spp))]
    return rows


def find_images(
    results: Path,
    rows: pd.DataFrame,
    clips: list[Path] | None = None,
    spp: Collection[float] | None = None,
    near: float = 1.0,
) -> tuple[ShownClips, str]:
    """The clips of `rows` with their kept images, not read yet, or the reason why there are none.

    Raises OptionError for a budget in `spp` without images; the default is the one nearest to
    `near`, in ratio.
    """
    from rlbench.benchmark.cell_images import list_images
    from rlbench.benchmark.shown_clips import ShownClips, find_shown_clips

    methods, names = set(rows["method"]), set(rows["clip"])
    kept = [each for each in list_images(results) if each.cell.key.method in methods]
    kept = [each for each in kept if each.cell.key.clip in names]
    if not kept:
        hint = "repeat the command `rlbench run` with --keep-images"
        return ShownClips(), f"the results keep no images; {hint}"
    known = {each.cell.key.target_spp for each in kept}
    if unknown := set(spp or ()) - known:
        raise OptionError(
            f"--spp: no images at {_join(unknown)} spp; the results keep {_join(known)}"
        )
    try:
        sources = find_sources(kept, clips)
    except OptionError as error:
        return ShownClips(), str(error)
    from reports.analysis.rows import nearest_budget

    budgets = spp or (nearest_budget(known, near),)
    return find_shown_clips(results, sources, methods, budgets), ""


def find_sources(
    kept: Collection[KeptImages], clips: list[Path] | None = None
) -> Sequence[StoredSource]:
    """The clips that images show: folders, or those of the presets, rendered where they lack.

    Raises OptionError where a clip has no preset, and no folder is given.
    """
    from rlbench.benchmark.planning import select_clips

    if clips:
        return select_clips(clips)
    by_preset: dict[str, set[str]] = {}
    for each in kept:
        by_preset.setdefault(each.cell.key.preset, set()).add(each.cell.key.clip)
    longest = max(map(len, kept), default=None)  # no frame is rendered that no image shows
    if strangers := by_preset.pop("", None):
        raise OptionError(
            f"the preset of {', '.join(sorted(strangers))} is not known; name the folder with "
            "--clips"
        )
    pools = {each.pool for each in kept}
    return [
        source
        for preset, own in sorted(by_preset.items())
        for source in select_clips(
            None, sorted(own), preset, pool_kinds=pools, limit_frames=longest
        )
    ]


def _join(budgets: Collection[float], separator: str = ", ") -> str:
    return separator.join(f"{spp:g}" for spp in sorted(budgets))
