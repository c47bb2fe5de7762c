"""The clip folders of a preset; what is missing of them is rendered."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor


def rendered(
    scenes: list[str] | None,
    preset: str,
    cap: float | None = None,
    chosen: tuple[int, ...] | None = None,
    views: list[str] | None = None,
    engine: Executor | None = None,
    kinds: Collection[str] | None = None,
    takes: str | None = None,
) -> list[Path]:
    """The clip folders of a preset, or of it with a radiance cap, or with more view buffers.

    Missing ones are rendered now, with those `kinds` of sample pools of the preset's, or all.
    Scenes, `takes` of each (main or all), and seeds of generated scenes replace those of the
    preset.
    """
    from rlbench import registry
    from rlbench.parallel.executor import LOCAL
    from rlbench.render.jobs.render_clips import ensure
    from rlbench.render.presets import PRESETS

    if preset not in PRESETS:
        raise OptionError(f"no preset '{preset}'; there are: {', '.join(PRESETS)}")
    known, wanted = registry.names("scenes"), scenes or []
    if unknown := [n for n in wanted if not {n, n.rpartition("-")[0]} & set(known)]:
        raise OptionError(f"no scene '{unknown[0]}'; there are: {', '.join(known)}")
    plan = PRESETS[preset]
    plan = plan if cap is None else plan.capped(cap)
    plan = plan.with_buffers(views) if views else plan
    plan = plan if kinds is None else plan.with_pools(kinds)
    plan = plan if takes is None else plan.with_takes(takes)
    return ensure(plan, wanted or None, chosen, engine=engine or LOCAL)
