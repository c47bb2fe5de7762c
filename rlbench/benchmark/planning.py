"""From options to a plan: all of them are checked, then clips are found, or rendered."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from numbers import Real
from pathlib import Path
from typing import Any

import torch

from rlbench import registry
from rlbench.backends import select_backend
from rlbench.benchmark.clip_sources import StoredSource, list_pools, open_source
from rlbench.benchmark.cost_profile import MEASURED, read_profile
from rlbench.benchmark.run_options import RunOptions
from rlbench.benchmark.run_plan import RunPlan
from rlbench.clips.presets import get_preset
from rlbench.clips.rendering import render_preset_clips
from rlbench.clips.stored import find_all_clips
from rlbench.errors import OptionError
from rlbench.parallel.executor import LOCAL, Executor
from rlbench.registry.near_names import unknown_name
from rlbench.system import paths
from rlbench.system.half_precision import require_half
from rlbench.system.paths import check_writable
from rlbench.weights import read_card

_NUMBERS = "give numbers, {}: one, or a list such as [{}]"


def plan_run(options: RunOptions) -> RunPlan:
    """The plan of a run of methods by name; everything is checked before a clip is rendered.

    Raises RlbenchError for names, budgets, files or devices that cannot be used.
    """
    names, budgets = tuple(as_list(options.methods)), check_budget_values(options.spp)
    target = select_device(options.device)
    weights = None if options.weights is None else str(options.weights)
    backend = select_backend(options.backend, target)
    check_precision(names, options.half, options.device, options.executor)
    preset = None if options.clips else options.preset
    check_run(names, budgets, Path(options.out), preset, options.cost, weights, options.pool)
    return RunPlan(
        methods=names,
        clips=select_clips(
            options.clips,
            options.scenes,
            options.preset,
            options.takes,
            options.pool,
            {registry.get_variant(name).traits.pool for name in names},
            options.executor,
            options.size,
            options.limit_frames,
        ),
        spp=budgets,
        seeds=check_seeds(options.seeds),
        device=target,
        cost=options.cost,
        weights=weights,
        weights_label=options.weights_label,
        weights_for=tuple(as_list(options.weights_for)),
        half=options.half,
        backend=backend,
        skip_tiles=options.skip_tiles,
        limit_frames=options.limit_frames,
        repeats=options.repeats,
    )


def select_clips(
    clips: Path | str | Iterable[Path | str] | None,
    scenes: str | Iterable[str] = (),
    preset: str = "mini",
    takes: str | None = None,
    pool: str = "stored",
    pool_kinds: Collection[str] | None = None,
    executor: Executor = LOCAL,
    size: tuple[int, int] | None = None,
    limit_frames: int | None = None,
) -> tuple[StoredSource, ...]:
    """The clips in the folders `clips`, or those of a preset, rendered where they are missing.

    `size` is the height and width in pixels of a preset's clips. `scenes` selects by the name of a
    scene or a clip. Samples are those that are "stored", or come from a "live" path tracer. Only
    the preset's pools of the given kinds are rendered; None renders all. With `limit_frames` only
    the first frames of a preset's clips are rendered, and clips in folders stay whole. Raises
    RlbenchError where a selection is empty or contradictory.
    """
    selected, limit_frames = as_list(scenes), check_limit(limit_frames)
    if pool not in (pools := list_pools()):
        raise OptionError(unknown_name(f"no pool '{pool}'", pool, pools))
    if clips is None:
        folders = render_preset_clips(
            selected,
            preset,
            executor=executor,
            pool_kinds=pool_kinds,
            takes=takes,
            size=size,
            limit_frames=limit_frames,
        )
        return tuple(open_source(folder, pool) for folder in folders)
    if takes is not None or size is not None:
        option = "--takes" if takes is not None else "--size"
        raise OptionError(
            f"{option} applies to preset scenes only. With --clips, select clips by name: "
            "--scenes NAME"
        )
    sources = [open_source(path, pool) for path in find_all_clips(as_list(clips))]
    names = {source: {source.header.scene, source.header.name} for source in sources}
    available = sorted(set().union(*names.values()))
    if unknown := [name for name in selected if name not in available]:
        problem = f"the clips show no scene {', '.join(unknown)}"
        raise OptionError(unknown_name(problem, unknown[0], available))
    return tuple(source for source in sources if not selected or names[source] & set(selected))


def check_budget_values(spp: float | Iterable[float]) -> tuple[float, ...]:
    """Different budgets in their order. Raises OptionError unless all are finite and above 0."""
    given = as_list(spp)
    if not given or not all(_is_number(each) and 0 < each < math.inf for each in given):
        raise OptionError(
            f"--spp {spp!r}: {_NUMBERS.format('samples per pixel above 0', '0.5, 1')}"
        )
    return tuple(dict.fromkeys(map(float, given)))


def check_seeds(seeds: int | Iterable[int]) -> tuple[int, ...]:
    """Different seeds in their order. Raises OptionError unless all are whole numbers from 0 on."""
    given = as_list(seeds)
    if not given or not all(_is_number(each) and each == int(each) >= 0 for each in given):
        raise OptionError(f"--seed {seeds!r}: {_NUMBERS.format('whole numbers from 0 on', '0, 1')}")
    return tuple(dict.fromkeys(map(int, given)))


def check_limit(frames: int | None) -> int | None:
    """A limit of frames. Raises OptionError unless it is a whole number above 0."""
    if frames is not None and not (_is_number(frames) and frames == int(frames) >= 1):
        raise OptionError(f"--limit-frames {frames!r}: give a whole number of frames, at least 1")
    return frames


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def as_list(values: Any) -> list[Any]:
    """One value or several as a list; a text is one value."""
    return (
        list(values) if isinstance(values, Iterable) and not isinstance(values, str) else [values]
    )


def check_precision(
    methods: Iterable[str], half: bool, device: str, executor: Executor = LOCAL
) -> None:
    """Raise OptionError if networks were to run in half precision on a device that emulates it.

    Other machines are asked by the executor's workers, cell by cell.
    """
    has_networks = any(registry.get_variant(name).learned for name in methods)
    if half and has_networks and not executor.description:
        require_half(select_device(device))


def select_device(name: str = "auto") -> torch.device:
    """The device of that name; "auto" is CUDA where it is available. Raises OptionError."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:  # its message names 25 back ends
        raise OptionError(
            f"device {name} cannot be used on this machine, it is not known. Use cpu, cuda or auto"
        ) from error
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).partition("\n")[0]
        raise OptionError(
            f"device {name} cannot be used on this machine: {reason}. Use cpu or auto"
        ) from error
    return device


def check_run(
    methods: Collection[str],
    spp: Collection[float],
    out: Path,
    preset: str | None,
    cost: str = MEASURED,
    weights: str | None = None,
    pool: str = "stored",
) -> None:
    """Check the options of a run that need no clip; nothing is written and no clip is opened.

    `preset` is that of the clips, None for clips in folders; their samples are those of `pool`
    (`rlbench.benchmark.clip_sources.list_pools`). Raises CostError for a cost profile,
    WeightsError for a weights file or its card, PluginError for a metric that cannot be used,
    WriteError where the results or the cache cannot be written, UnknownPresetError, and
    OptionError where no method can be measured at any budget.
    """
    if cost != MEASURED:
        read_profile(cost)
    if weights not in (None, "random"):
        read_card(Path(weights))
    if preset is not None:
        check_budgets(methods, spp, preset, pool)
    registry.load_run_metrics()
    check_writable(out)
    check_writable(paths.cache_folder(), "RLBENCH_CACHE")


def check_budgets(
    methods: Collection[str], spp: Collection[float], preset: str, pool: str = "stored"
) -> None:
    """Raise OptionError where no method can be measured on the preset's clips at any budget.

    A method that cannot at some budgets is skipped there, with the reason in its row. Live samples
    are traced when they are drawn, so there are as many as a budget needs.
    """
    stored = get_preset(preset).pool_spp
    if pool == "stored" and min(spp, default=0.0) > stored:
        raise OptionError(
            f"--spp {_join(spp)}: the clips of preset '{preset}' store {stored} samples per "
            f"pixel, and no method is measured with more; request at most {stored}, or trace "
            "more with --pool live"
        )
    traits = {name: registry.get_variant(name).traits for name in methods}
    reasons = {
        f"{name} {reason}": None
        for budget in spp
        for name, each in traits.items()
        if (reason := each.unsupported_reason(budget))
    }
    if reasons and len(reasons) == len(traits) * len(spp):
        raise OptionError(f"--spp {_join(spp)}: {'; '.join(reasons)}")


def _join(budgets: Collection[float]) -> str:
    return ",".join(f"{spp:g}" for spp in budgets)
