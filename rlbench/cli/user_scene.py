"""Which tracer renders a user's scene file, and the call of that tracer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor
    from rlbench.render.presets import Preset
    from rlbench.render.user.clip import UserSceneOptions

__all__ = ["render_clip", "select_tracer"]


def render_clip(
    scene: UserSceneOptions, preset: Preset, tracer: str | None, executor: Executor
) -> Path:
    """The clip folder of a scene file, after rendering the missing frames.

    Raises OptionError if the tracer does not read the file, or not with this executor.
    """
    from rlbench.parallel.executor import LOCAL
    from rlbench.render.cycles.clip import ensure_cycles
    from rlbench.render.user.clip import ensure_user_clip

    def on_message(message: str) -> None:
        typer.echo(message, err=True)

    if select_tracer(scene.file, tracer) == "mitsuba":
        return ensure_user_clip(scene, preset, on_message, executor)
    if executor is not LOCAL:
        raise OptionError(
            "--engine ray cannot render with Cycles, which uses all cores by itself. Omit it"
        )
    return ensure_cycles(scene, preset, on_message)


def select_tracer(file: Path, tracer: str | None) -> str:
    """The requested tracer, or the one that reads the file's format.

    Raises OptionError if no tracer, or not the requested one, reads it.
    """
    from rlbench.render.cycles.scene_file import FORMATS

    formats = {"mitsuba": (".xml", ".py"), "cycles": FORMATS}
    readers = [name for name, suffixes in formats.items() if file.suffix.lower() in suffixes]
    supported = "; ".join(f"{name} reads {', '.join(formats[name])}" for name in formats)
    if not readers:
        raise OptionError(f"scene file {file}: no tracer reads this format. {supported}")
    if tracer not in (None, *readers):
        raise OptionError(f"--tracer {tracer} does not read {file.name}. {supported}")
    return readers[0]
