"""Are results of the clips, code and weights that are here now?

A submission states the digests of the clips here. The identity of each cell in the results covers
its clip, so it is computed anew and compared: a digest is never stated for a clip that a score is
not of.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping

from rlbench import registry
from rlbench.benchmark.cell_key import CellId, CellKey
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.content_hash import CellIds
from rlbench.benchmark.results import RowName
from rlbench.benchmark.run_plan import RunPlan, list_cells

__all__ = ["plan_of", "uncheckable_methods", "outdated_cells"]


def outdated_cells(stored: Iterable[CellId], clips: Mapping[str, StoredSource]) -> list[CellKey]:
    """The cells whose scores are of other content than a run would measure now, sorted by name.

    Cells of `uncheckable_methods` are left out.
    """
    groups: dict[str, list[CellId]] = defaultdict(list)
    for cell in stored:
        if not cell.key.metric and cell.key.clip in clips:
            groups[cell.key.method].append(cell)
    outdated = []
    for method, cells in groups.items():
        if uncheckable_methods([method]):
            continue
        spp = tuple(sorted({cell.key.target_spp for cell in cells}))
        seeds = tuple(sorted({cell.key.seed for cell in cells}))
        names = sorted({cell.key.clip for cell in cells})
        plan = plan_of(method, [clips[name] for name in names], spp, seeds)
        ids = CellIds(plan)
        now = {_slot(cell.key): ids.cell_id(cell) for cell in list_cells(plan)}
        here = {key.device for key in (each.key for each in now.values())}
        outdated += [
            cell.key
            for cell in cells
            if cell.key.device in here and not cell.has_scores_of(now[_slot(cell.key)])
        ]
    return sorted(outdated, key=str)


def uncheckable_methods(names: Iterable[str]) -> list[str]:
    """The rows that cannot be measured here: weights that do not ship, or a method not installed.

    >>> uncheckable_methods(["mean", "ours@seed3", "nobody"])
    ['nobody', 'ours@seed3']
    """
    return sorted(name for name in set(names) if not _is_reproducible(name))


def plan_of(
    row: str, clips: Collection[StoredSource], spp: tuple[float, ...], seeds: tuple[int, ...]
) -> RunPlan:
    """The run that measures a row on this machine's processor."""
    name = RowName.parse(row)
    return RunPlan(
        (name.method,),
        tuple(clips),
        spp,
        seeds,
        bf16=name.options.bf16,
        backend=name.options.backend,
        skip_tiles=name.options.skip_tiles,
    )


def _is_reproducible(row: str) -> bool:
    name = RowName.parse(row)
    try:
        registry.get_variant(name.method)
    except registry.PluginError:
        return False
    return not name.options.weights


def _slot(key: CellKey) -> tuple[str, str, float, int]:
    return key.method, key.clip, key.target_spp, key.seed
