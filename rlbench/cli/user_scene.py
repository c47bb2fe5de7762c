"""The options of a user's own scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor


def own_scene(
    scene: Path | None,
    scenes: list[str] | None,
    preset: str,
    camera: str | None,
    frames: int | None,
    size: str | None,
    exposure: float | None,
    define: list[str] | None,
    out: Path | None,
    tracer: str | None = None,
    engine: Executor | None = None,
) -> Path:
    """The clip folder of one's own scene; what is missing of it is rendered now."""
    if scene is None or scenes:
        raise OptionError(
            "--camera, --frames, --size, --exposure, --define, --out and --tracer belong to "
            "--scene FILE, which is given without --scenes and --seeds"
        )
    from rlbench.parallel.executor import LOCAL
    from rlbench.render.cycles.clip import ensure_cycles
    from rlbench.render.presets import get_preset as preset_of
    from rlbench.render.user.clip import UserSceneOptions, ensure_user_clip

    if exposure is not None and not 0 < exposure < float("inf"):
        raise OptionError(f"--exposure takes a number above 0 and was given {exposure}")
    if wrong := [item for item in define or () if not item.partition("=")[0] or "=" not in item]:
        raise OptionError(f"--define takes name=value and was given '{wrong[0]}'")
    pairs = [item.partition("=") for item in define or ()]
    wish = UserSceneOptions(
        file=scene,
        camera=camera or "",
        frames=frames,
        size=_size(size) if size else None,
        exposure=exposure,
        parameters=tuple((name, value) for name, _, value in pairs),
        out=out,
    )
    plan, tell = preset_of(preset), lambda words: typer.echo(words, err=True)
    if tracer_of(scene, tracer) == "mitsuba":
        return ensure_user_clip(wish, plan, tell, engine or LOCAL)
    if engine not in (None, LOCAL):
        raise OptionError(
            "--engine ray does not render with Cycles, which uses all cores by itself"
        )
    return ensure_cycles(wish, plan, tell)


def tracer_of(scene: Path, asked: str | None) -> str:
    """Which tracer renders a scene file: the one that reads its format. Raises AskedError."""
    from rlbench.render.cycles.scene_file import FORMATS

    reads = {"mitsuba": (".xml", ".py"), "cycles": FORMATS}
    fits = [name for name, kinds in reads.items() if scene.suffix.lower() in kinds]
    if asked is None and not fits:
        told = "; ".join(f"{name} reads {', '.join(kinds)}" for name, kinds in reads.items())
        raise OptionError(f"--scene {scene}: no tracer reads it; {told}")
    if asked is not None and asked not in fits:
        known = (
            f"it reads {', '.join(reads[asked])}" if asked in reads else "it is mitsuba or cycles"
        )
        raise OptionError(f"--tracer {asked} does not read {scene.name}; {known}")
    return fits[0]


def _size(text: str) -> tuple[int, int]:
    """Height and width of `WxH`. Raises AskedError."""
    wide, _, high = text.partition("x")
    if not (wide.isdecimal() and high.isdecimal() and int(wide) and int(high)):
        raise OptionError(f"--size takes width x height, such as 320x192, and was given '{text}'")
    return int(high), int(wide)
