"""The command run: measure methods on clips."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Literal

import typer

from rlbench.cli import arguments, options
from rlbench.cli.arguments import Seeds, WeightsChoice
from rlbench.cli.plugins import load_plugins, load_rows
from rlbench.cli.verbosity import note
from rlbench.errors import OptionError
from rlbench.system.process_settings import wait_asleep

__all__ = ["run", "warn_without_networks"]


def run(
    context: typer.Context,
    methods: options.Methods = None,
    weights: options.Weights = None,
    bf16: options.Bf16 = False,
    backend: options.Backend = "eager",
    skip_tiles: Annotated[
        bool,
        typer.Option(
            "--skip-tiles",
            help="keep unchanged tiles of methods with a receptive field, for rows METHOD@tiles",
            rich_help_panel=options.METHODS,
        ),
    ] = False,
    plugin: options.Plugins = None,
    scenes: options.Scenes = None,
    preset: options.Preset = "mini",
    takes: options.Takes = None,
    clips: options.Clips = None,
    spp: options.Spp = options.DEFAULT_SPP,
    pool: Annotated[
        Literal["stored", "live"],
        typer.Option(
            help="stored samples of the clip, or live ones, traced when they are drawn",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = "stored",
    seed: Annotated[
        Seeds,
        typer.Option(
            parser=arguments.parse_seeds,
            metavar="SEEDS",
            show_default=False,
            help="seeds of the sample order and of rounding, such as 0,1,2; default: 0",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = options.DEFAULT_SEEDS,
    draws: options.Draws = None,
    cost: options.Cost = "measured",
    repeats: Annotated[
        int,
        typer.Option(
            min=1,
            help="fewest timed frames of a row; more are timed until the median is steady",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = 10,
    retime: Annotated[
        bool,
        typer.Option(
            "--retime",
            help="measure the times of existing cells again, and no scores",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = False,
    scores_only: Annotated[
        bool,
        typer.Option(
            "--scores-only",
            help="measure no times; a later run without it, on a quiet machine, adds them",
            rich_help_panel=options.MEASUREMENT,
        ),
    ] = False,
    limit_frames: options.LimitFrames = None,
    device: options.Device = "auto",
    engine: options.Engine = "local",
    ray_address: options.RayAddress = None,
    keep_images: Annotated[
        bool,
        typer.Option(
            "--keep-images",
            help="keep the image of each frame, for rlbench evaluate; cells without are run again",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
    out: options.ResultsOut = Path("results"),
    as_json: options.Json = False,
) -> None:
    """Score and time methods on clips, and add the results.

    Without --methods, the rows of `make demo` are measured, and those of --plugin; -m all measures
    one row of every method. Cells that the results hold already are not measured again, so a killed
    run resumes. A damaged row file is set aside, and its cell is measured again. The exit code is 1
    if an error stopped a cell, if an image is not finite, or if there are no numbers; the last line
    names the cells.

    Examples:

    \b
      rlbench run
      rlbench run --methods ours,ntas
      rlbench run -m ours -m 'oidn/*' --scenes city --spp 1,4 --cost paper-2080ti --out paper
      rlbench run -m mine --plugin mine.py --clips my_renders/ --out mine
      rlbench run -m ours,mean --draws 4 --out draws
      rlbench run -m ours --scenes temple --pool live --out live
      rlbench run -m ours --weights seed1=runs/seed1/ours/ours.safetensors
      rlbench run -m ours,oidn --bf16
      rlbench run -m ours,oidn --backend openvino
      rlbench run -m eaw/still --spp 0.25 --skip-tiles
      rlbench run -m ours,oidn --retime
      rlbench run -m ours,oidn --scores-only
      rlbench run -m ours,oidn --keep-images
      rlbench run -m all --preset standard --takes main --engine ray --out large
    """
    seeds = _orders(seed, draws)
    if scores_only:
        wait_asleep()  # before a plugin imports torch
    names = _select_methods(context, plugin, methods)  # before torch
    chosen = weights or WeightsChoice()
    from rlbench import registry
    from rlbench.backends import select_backend
    from rlbench.benchmark.api import check_precision, check_run, select_clips, select_device
    from rlbench.benchmark.run_outcome import read_outcome
    from rlbench.benchmark.run_plan import RunPlan
    from rlbench.benchmark.runner import check_times_alone, measure
    from rlbench.cli import console, json_output
    from rlbench.parallel.ray_executor import open_executor

    if retime:
        check_times_alone(scores_only, keep_images)
    warn_without_networks(names, bf16, chosen)
    target = select_device(device)
    selected_backend = select_backend(backend, target)
    check_run(names, spp, out, None if clips else preset, cost, chosen.file, pool)
    pools = {registry.get_variant(name).traits.pool for name in names}
    scene_names = arguments.split_names(scenes)
    with open_executor(engine, ray_address) as executor:
        check_precision(names, bf16, device, executor)
        plan = RunPlan(
            methods=names,
            clips=select_clips(clips, scene_names, preset, takes, pool, pools, executor),
            spp=spp,
            seeds=seeds,
            device=target,
            cost=cost,
            weights=chosen.file,
            weights_label=chosen.label,
            bf16=bf16,
            backend=selected_backend,
            skip_tiles=skip_tiles,
            limit_frames=limit_frames,
            repeats=repeats,
        )
        with console.measuring(plan) as bar:
            summary = measure(
                plan,
                out,
                bar.on_cell,
                executor,
                bar.on_timing,
                retime=retime,
                scores_only=scores_only,
                keep_images=keep_images,
            )
    outcome = read_outcome(plan, summary, out)
    if as_json:
        json_output.print_json(json_output.run_output(outcome))
    else:
        console.print_outcome(outcome)
    if not outcome.verdict.has_passed:
        raise typer.Exit(1)


def _select_methods(
    context: typer.Context, plugins: list[Path] | None, patterns: list[str] | None
) -> tuple[str, ...]:
    """The methods to run; without any, those of a first run, and a note that says so."""
    from rlbench import registry

    load_plugins(plugins, allow_broken=True)  # those of a first run include their methods
    selected = arguments.split_names(patterns) or registry.demo_methods()
    load_rows(context, None, selected)
    names = arguments.expand_methods(selected)
    if not patterns:
        note(f"rows of a first run: {', '.join(names)}; -m all runs one row of every method")
    return names


def _orders(seeds: Seeds, draws: int | None) -> tuple[int, ...]:
    """The seeds of the sample order. Raises OptionError if they are given twice."""
    if draws is None:
        return seeds
    if seeds != options.DEFAULT_SEEDS:
        raise OptionError(
            f"--draws {draws} is --seed 0:{draws}, and --seed was given too. Omit one"
        )
    return tuple(range(draws))


def warn_without_networks(names: Collection[str], bf16: bool, weights: WeightsChoice) -> None:
    """Say that --bf16 and --weights have no effect, if no method has networks."""
    from rlbench import registry

    has_networks = any(registry.get_variant(name).learned for name in names)
    if (bf16 or weights.file) and not has_networks:
        text = f"--bf16 and --weights have no effect, because {', '.join(names)} has no networks"
        note(text)
