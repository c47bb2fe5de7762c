"""What was asked for on the command line, checked and turned into what the bench takes."""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    import pandas as pd
    import torch

    from rlbench.benchmark.clip_sources import Stored
    from rlbench.benchmark.regression import Baseline
    from rlbench.parallel.executor import Engine


class AskedError(ValueError):
    """An option's value that cannot be used."""


def split(values: list[str]) -> list[str]:
    """Names given as `a,b`, as several options, or both."""
    return [part.strip() for value in values for part in value.split(",") if part.strip()]


def numbers(option: str, text: str, kind: type[Any]) -> tuple[Any, ...]:
    """Finite numbers >= 0 given as `1,2`, each once. Raises AskedError."""
    try:
        found = tuple(dict.fromkeys(kind(part) for part in split([text])))
    except ValueError:
        found = ()
    if not found or not all(math.isfinite(number) and number >= 0 for number in found):
        such = "0,1,2" if kind is int else "0.5,1,2"
        raise AskedError(f"{option} takes numbers such as {such} and was given '{text}'")
    return found


def device(name: str) -> torch.device:
    """A device that works here; `auto` is CUDA where there is one. Raises AskedError."""
    import torch

    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        found = torch.device(name)
        torch.empty(0, device=found)
    except (RuntimeError, AssertionError) as error:
        raise AskedError(f"--device {name} cannot be used here: {error}") from error
    return found


def clips(
    own: list[Path] | None,
    scenes: list[str] | None,
    preset: str,
    pool: str = "stored",
    engine: Engine | None = None,
    kinds: Collection[str] | None = None,
    takes: str | None = None,
) -> tuple[Stored, ...]:
    """The clips of one's own folders, or those of a preset, rendered if need be.

    `kinds` of sample pools are those that are wanted of a preset's, and `takes` of its scenes are
    `main` or `all`; None is all of the former, and the latter as in the preset.
    """
    from rlbench.benchmark.clip_sources import POOLS, pooled
    from rlbench.clips.stored import below

    if pool not in POOLS:
        raise AskedError(f"--pool {pool}: samples are one of: {', '.join(POOLS)}")
    if own is None:
        made = rendered(split(scenes or []), preset, engine=engine, kinds=kinds, takes=takes)
        return tuple(pooled(folder, pool) for folder in made)
    if takes is not None:
        raise AskedError("--takes is of a preset's scenes; of --clips, --scenes names single clips")
    found = [pooled(folder, pool) for place in own for folder in below(place)]
    wanted = split(scenes or [])
    named = {clip: {clip.header.scene, clip.header.name} for clip in found}
    kept = tuple(clip for clip, names in named.items() if not wanted or names & set(wanted))
    if unknown := [name for name in wanted if not any(name in names for names in named.values())]:
        have = ", ".join(sorted({clip.header.scene for clip in found})) or "none"
        raise AskedError(f"--scenes {','.join(unknown)}: the clips given show: {have}")
    return kept


def methods(values: list[str], trained: bool = True) -> tuple[str, ...]:
    """Names that were asked for, as `registry.expand`; `all` goes on without broken families."""
    from rlbench.registry import lookup as registry

    return tuple(registry.expand(split(values), trained, lambda words: typer.echo(words, err=True)))


def positive(option: str, number: float) -> float:
    """A number above zero. Raises AskedError."""
    if not number > 0:
        raise AskedError(f"{option} {number:g}: it has to be above 0")
    return number


def minutes(number: float | None) -> float:
    """What `--minutes` allows: without it, for ever. Raises AskedError."""
    return math.inf if number is None else positive("--minutes", number)


def weights(text: str | None) -> tuple[str, str | None]:
    """What `--weights NAME=FILE` calls them, or nothing, and the file. Raises AskedError."""
    from rlbench.benchmark.results import CROSSVAL, HALF

    if text is None or text == "random":
        return "", text
    called, equals, file = text.partition("=")
    if not equals or Path(text).exists():
        called, file = "", text
    elif not re.fullmatch(r"[\w+-]+", called, re.ASCII):
        raise AskedError(f"--weights {text}: the name before = is of letters, digits, _, + and -")
    elif (kind := called.partition("-")[0]) in (HALF, CROSSVAL):
        raise AskedError(f"--weights {text}: METHOD@{kind} is what rows of another kind are called")
    if not Path(file).is_file():
        raise AskedError(f"--weights {text}: there is no file {file}; 'rlbench train' makes one")
    return called, file


def part(
    table: pd.DataFrame, baseline: Baseline, methods: Collection[str]
) -> tuple[pd.DataFrame, Baseline]:
    """The rows and the entries of some methods. Raises AskedError for one that neither has."""
    have = {*table["method"], *(entry.method for entry in baseline.entries)}
    if unknown := sorted(set(methods) - have):
        raise AskedError(
            f"--only {','.join(unknown)}: neither results nor baseline have it; there is: "
            f"{', '.join(sorted(have)) or 'nothing'}"
        )
    entries = tuple(entry for entry in baseline.entries if entry.method in methods)
    return table[table["method"].isin(methods)], replace(baseline, entries=entries)


def rows(table: pd.DataFrame, methods: Collection[str], results: Path) -> pd.DataFrame:
    """The rows of methods, by any name that the table has or a pattern leads to.

    Raises AskedError where a single name has none, and PluginError for one that is in neither.
    """
    from rlbench.benchmark.results import AT, whose
    from rlbench.registry import lookup as registry

    known = set(table["method"])  # of plugins too, which need not be here
    exact = [name for name in methods if AT in name or name in known]
    patterns = [name for name in methods if name not in exact]
    wanted = exact + registry.expand(patterns, trained=False)  # what has rows had weights
    found = table[whose(table, wanted)]
    single = [n for n in methods if n.partition("/")[0] != "all" and not n.endswith("/*")]
    absent = [name for name in single if not whose(table, [name]).any()]
    if absent or found.empty:
        have = ", ".join(sorted(known)) or "no rows"
        raise AskedError(f"{results} has no rows of {', '.join(absent or methods)}; it has: {have}")
    return found


def seeds(text: str | None) -> tuple[int, ...] | None:
    """Seeds given as `0:48`, without 48, as `3,7`, or both; None if none. Raises AskedError."""
    if text is None:
        return None
    found: dict[int, None] = {}
    for part in split([text]) or [""]:
        first, colon, after = part.partition(":")
        numbers = range(0)
        if first.isdecimal() and (after.isdecimal() if colon else True):
            numbers = range(int(first), int(after) if colon else int(first) + 1)
        if not numbers:
            raise AskedError(
                f"--seeds takes a range such as 0:48, of which 48 is no part, or a list such as "
                f"3,7, and was given '{text}'"
            )
        found |= dict.fromkeys(numbers)
    return tuple(found)


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
    engine: Engine | None = None,
) -> Path:
    """The clip folder of one's own scene; what is missing of it is rendered now."""
    if scene is None or scenes:
        raise AskedError(
            "--camera, --frames, --size, --exposure, --define, --out and --tracer belong to "
            "--scene FILE, which is given without --scenes and --seeds"
        )
    from rlbench.parallel.executor import LOCAL
    from rlbench.render.cycles.clip import ensure_cycles
    from rlbench.render.presets import preset as preset_of
    from rlbench.render.user.clip import Wish, ensure_own

    if exposure is not None and not 0 < exposure < float("inf"):
        raise AskedError(f"--exposure takes a number above 0 and was given {exposure}")
    if wrong := [item for item in define or () if not item.partition("=")[0] or "=" not in item]:
        raise AskedError(f"--define takes name=value and was given '{wrong[0]}'")
    pairs = [item.partition("=") for item in define or ()]
    wish = Wish(
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
        return ensure_own(wish, plan, tell, engine or LOCAL)
    if engine not in (None, LOCAL):
        raise AskedError("--engine ray does not render with Cycles, which uses all cores by itself")
    return ensure_cycles(wish, plan, tell)


def tracer_of(scene: Path, asked: str | None) -> str:
    """Which tracer renders a scene file: the one that reads its format. Raises AskedError."""
    from rlbench.render.cycles.scene_file import FORMATS

    reads = {"mitsuba": (".xml", ".py"), "cycles": FORMATS}
    fits = [name for name, kinds in reads.items() if scene.suffix.lower() in kinds]
    if asked is None and not fits:
        told = "; ".join(f"{name} reads {', '.join(kinds)}" for name, kinds in reads.items())
        raise AskedError(f"--scene {scene}: no tracer reads it; {told}")
    if asked is not None and asked not in fits:
        known = (
            f"it reads {', '.join(reads[asked])}" if asked in reads else "it is mitsuba or cycles"
        )
        raise AskedError(f"--tracer {asked} does not read {scene.name}; {known}")
    return fits[0]


def _size(text: str) -> tuple[int, int]:
    """Height and width of `WxH`. Raises AskedError."""
    wide, _, high = text.partition("x")
    if not (wide.isdecimal() and high.isdecimal() and int(wide) and int(high)):
        raise AskedError(f"--size takes width x height, such as 320x192, and was given '{text}'")
    return int(high), int(wide)


def rendered(
    scenes: list[str] | None,
    preset: str,
    cap: float | None = None,
    chosen: tuple[int, ...] | None = None,
    views: list[str] | None = None,
    engine: Engine | None = None,
    kinds: Collection[str] | None = None,
    takes: str | None = None,
) -> list[Path]:
    """The clip folders of a preset, or of it with a radiance cap, or with more view buffers.

    Missing ones are rendered now, with those `kinds` of sample pools of the preset's, or all.
    Scenes, `takes` of each (main or all), and seeds of generated scenes replace those of the
    preset.
    """
    from rlbench.parallel.executor import LOCAL
    from rlbench.registry import lookup as registry
    from rlbench.render.jobs.render_clips import ensure
    from rlbench.render.presets import PRESETS

    if preset not in PRESETS:
        raise AskedError(f"no preset '{preset}'; there are: {', '.join(PRESETS)}")
    known, wanted = registry.names("scenes"), scenes or []
    if unknown := [n for n in wanted if not {n, n.rpartition("-")[0]} & set(known)]:
        raise AskedError(f"no scene '{unknown[0]}'; there are: {', '.join(known)}")
    plan = PRESETS[preset]
    plan = plan if cap is None else plan.capped(cap)
    plan = plan.showing(views) if views else plan
    plan = plan if kinds is None else plan.selling(kinds)
    plan = plan if takes is None else plan.filming(takes)
    return ensure(plan, wanted or None, chosen, engine=engine or LOCAL)
