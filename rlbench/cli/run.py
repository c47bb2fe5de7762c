"""The command run: measure methods on clips."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.benchmark.run_options import AGAIN, RunOptions, Times
from rlbench.cli import config_file, options
from rlbench.cli.arguments import Seeds, parse_seeds, split_names
from rlbench.cli.methods import expand_methods, load_plugins, load_rows, warn_without_networks
from rlbench.cli.options import EXECUTION, MEASUREMENT, METHODS, OUTPUT, fill, flag, folder, option
from rlbench.cli.verbosity import note
from rlbench.errors import OptionError
from rlbench.system.process_settings import wait_asleep

FIRST_RUN = ("ours", "ntas", "oidn", "oidn/tuned", "mean")  # rows without --methods: make demo


def run(
    context: typer.Context,
    methods: options.Methods = None,
    plugin: options.Plugins = None,
    scenes: options.Scenes = None,
    preset: options.Preset = "mini",
    size: options.Size = None,
    clips: options.Clips = None,
    spp: options.Spp = options.DEFAULT_SPP,
    cost: options.Cost = "measured",
    out: Annotated[Path, folder("results folder; new rows are added to it")] = Path("results"),
    keep_images: Annotated[
        bool,
        flag(
            OUTPUT,
            "--keep-images",
            "keep the image of each frame, for rlbench evaluate; cells without are run again",
        ),
    ] = False,
    as_json: options.Json = False,
    weights: options.Weights = options.SHIPPED,
    half: options.Half = False,
    backend: options.Backend = "eager",
    skip_tiles: Annotated[
        bool,
        flag(
            METHODS,
            "--skip-tiles",
            "keep unchanged tiles of methods with a receptive field, for rows METHOD@tiles",
        ),
    ] = False,
    takes: options.Takes = None,
    pool: Annotated[
        str,
        option(
            MEASUREMENT,
            "stored: samples of the clip; live: traced when they are drawn",
            value="POOL",
        ),
    ] = "stored",
    seed: Annotated[
        Seeds,
        option(
            MEASUREMENT,
            "seeds of the sample order and of rounding, such as 0,1,2; default: 0",
            value="SEEDS",
            parse=parse_seeds,
            show_default=False,
        ),
    ] = options.DEFAULT_SEEDS,
    draws: Annotated[
        int | None,
        option(MEASUREMENT, "number of sample orders: --draws 3 is --seed 0,1,2", min=1),
    ] = None,
    repeats: options.Repeats = 10,
    times: Annotated[
        Times,
        option(
            MEASUREMENT,
            "missing: what the results lack; uncertain: such times again, the clips' time of a "
            "sample too, and no scores; again: all times, and no scores; none: a later run, on a "
            "quiet machine, adds them",
            value="TIMES",
        ),
    ] = "missing",
    limit_frames: options.LimitFrames = None,
    device: options.Device = "auto",
    engine: options.Engine = "local",
    config: Annotated[
        Path | None,
        option(
            EXECUTION,
            "options from a TOML file, such as the run.toml that every run writes into --out; "
            "those on the command line win",
            value="FILE",
            exists=True,
            dir_okay=False,
            is_eager=True,
            callback=config_file.use,
        ),
    ] = None,
    allow_plugins: Annotated[
        bool,
        flag(
            EXECUTION,
            "--allow-plugins",
            "let the file of --config name plugin files and an engine, which run code",
        ),
    ] = False,
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
      rlbench run -m ours,oidn --preset development --size 640x360 --out large
      rlbench run -m ours --scenes temple --pool live --out live
      rlbench run -m ours,oidn --weights ours=runs/ours/ours.safetensors
      rlbench run -m ours --weights seed1=runs/seed1/ours/ours.safetensors
      rlbench run --config results/run.toml --out again
      rlbench run --config mine/run.toml --allow-plugins --out again
      rlbench run -m ours,oidn --half
      rlbench run -m ours,oidn --backend openvino
      rlbench run -m eaw/still --spp 0.25 --skip-tiles
      rlbench run --config results/run.toml --times uncertain
      rlbench run -m ours,oidn --times none
      rlbench run -m ours,oidn --keep-images
      rlbench run -m all --preset standard --takes main --engine ray --out large
    """
    config_file.check_trusted(context, config, allow_plugins)
    seeds = _sample_orders(seed, draws)
    if times == "none":
        wait_asleep()  # before a plugin imports torch
    names = _select_methods(context, plugin, methods)  # before torch
    chosen = weights.for_methods(names)
    from rlbench.benchmark.planning import plan_run
    from rlbench.benchmark.run_outcome import read_outcome
    from rlbench.benchmark.runner import check_times, measure
    from rlbench.cli import console, json_output
    from rlbench.parallel.engines import open_executor

    if times in AGAIN:  # what the cells' own run wrote into its file says nothing of this one
        keep_images &= config_file.is_typed(context, "keep_images")
    check_times(times, keep_images)
    warn_without_networks(names, half, chosen)
    with open_executor(engine) as executor:
        plan = plan_run(
            fill(
                RunOptions,
                locals(),
                methods=names,
                scenes=split_names(scenes),
                seeds=seeds,
                weights=chosen.file,
                weights_label=chosen.label,
                weights_for=chosen.methods,
                executor=executor,
            )
        )
        with console.measuring(plan) as bar:
            callbacks = (bar.on_cell, executor, bar.on_timing)
            summary = measure(plan, out, *callbacks, times=times, keep_images=keep_images)
    config_file.write(context, out / "run.toml", ("times",) if times in AGAIN else ())
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
    load_plugins(plugins, allow_broken=True)  # those of a first run include their methods
    selected = split_names(patterns) or first_run()
    load_rows(context, None, selected)
    names = expand_methods(selected)
    if not patterns:
        note(f"rows of a first run: {', '.join(names)}; -m all runs one row of every method")
    return names


def first_run() -> list[str]:
    """The rows of a run without --methods: those of `make demo`, then those of plugin files."""
    from rlbench import registry

    return list(dict.fromkeys([*FIRST_RUN, *registry.plugin_file_methods()]))


def _sample_orders(seeds: Seeds, draws: int | None) -> tuple[int, ...]:
    """The seeds of the sample order. Raises OptionError if they are given twice."""
    if draws is None:
        return seeds
    if seeds != options.DEFAULT_SEEDS:
        raise OptionError(
            f"--draws {draws} is --seed 0:{draws}, and --seed was given too. Omit one"
        )
    return tuple(range(draws))
