"""The clips of presets, rendered where they are missing, by what an installed app provides."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rlbench.errors import OptionError
from rlbench.registry import apps

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor


class PresetRenderer(Protocol):
    """Renders the missing frames of a preset's clips; `App.renderer` names one."""

    def __call__(
        self,
        scenes: Sequence[str] | None,
        preset: str,
        *,
        seeds: Sequence[int] | None = None,
        executor: Executor | None = None,
        pool_kinds: Collection[str] | None = None,
        takes: str | None = None,
        size: tuple[int, int] | None = None,
        limit_frames: int | None = None,
    ) -> list[Path]:
        """The clip folders of a preset, at its size or at `size` pixels (height, width).

        `scenes`, `seeds` of generated scenes and `takes` (main or all) replace those of the preset.
        Of its sample pools only the given kinds are rendered; None is all. With `limit_frames` the
        frames after the first ones are not rendered. Raises UnknownPresetError and OptionError for
        an unknown preset or scene, and PresetError for other values.
        """


def render_preset_clips(scenes: Sequence[str] | None, preset: str, **options: Any) -> list[Path]:
    """The clip folders of a preset, after the installed renderer rendered the missing frames.

    Arguments are those of `PresetRenderer`. Raises OptionError where no renderer is installed.
    """
    renderers: list[PresetRenderer] = apps.load_parts("renderer")
    if not renderers:
        raise OptionError(
            f"--preset {preset}: no installed app renders the clips of presets. Name folders of "
            "clips: --clips FOLDER"
        )
    return renderers[0](scenes, preset, **options)
