"""The clip folders of a preset, for commands and training: renders the missing frames."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor

__all__ = ["render_preset_clips"]


def render_preset_clips(
    scenes: list[str] | None,
    preset: str,
    radiance_cap: float | None = None,
    seeds: tuple[int, ...] | None = None,
    buffers: list[str] | None = None,
    executor: Executor | None = None,
    pool_kinds: Collection[str] | None = None,
    takes: str | None = None,
) -> list[Path]:
    """The clip folders of a preset, after rendering the missing frames.

    `radiance_cap` and extra G-buffer `buffers` select a variant of the preset, in folders of its
    own. `scenes`, seeds of generated scenes, and `takes` (main or all) replace those of the preset.
    Of its sample pools only the given kinds are rendered; default all. Raises UnknownPresetError
    and OptionError for an unknown preset or scene, and PresetError for other values.
    """
    from rlbench import registry
    from rlbench.parallel.executor import LOCAL
    from rlbench.registry.near_names import unknown_name
    from rlbench.render.jobs.render_clips import ensure
    from rlbench.render.presets import get_preset

    selected = get_preset(preset)
    installed = registry.list_plugins("scenes")
    for name in scenes or ():
        if not {name, name.rpartition("-")[0]} & set(installed):
            raise OptionError(unknown_name(f"no scene '{name}'", name, installed))
    if radiance_cap is not None:
        selected = selected.with_radiance_cap(radiance_cap)
    if buffers:
        selected = selected.with_buffers(buffers)
    if pool_kinds is not None:
        selected = selected.with_pools(pool_kinds)
    if takes is not None:
        selected = selected.with_takes(takes)
    return ensure(selected, scenes or None, seeds, executor=executor or LOCAL)
