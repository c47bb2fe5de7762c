"""The command decide: which denoiser gives the least error in a frame time."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench import api
from rlbench.cli import options
from rlbench.cli.arguments import split_names
from rlbench.cli.json_output import as_json_text
from rlbench.cli.methods import load_plugins, plugin_words
from rlbench.cli.options import MEASUREMENT, METHODS, flag, number, option
from rlbench.cli.selection import read_rows
from rlbench.errors import OptionError
from rlbench.registry.near_names import unknown_name

if TYPE_CHECKING:
    import pandas as pd


def decide(
    frame_ms: Annotated[
        float,
        number(MEASUREMENT, "the deadline: 16.7 for 60 frames a second", "MS"),
    ],
    sample_ms: Annotated[
        float | None,
        number(
            MEASUREMENT,
            "your renderer's time for one sample of every pixel; default: that in COST",
            "MS",
        ),
    ] = None,
    gbuffer_ms: options.GbufferMs = None,
    methods: options.RowMethods = None,
    scenes: options.RowScenes = None,
    needs: Annotated[
        list[str] | None,
        option(
            METHODS,
            "consider only methods that need none but these G-buffer channels a,b",
            value="NAMES",
        ),
    ] = None,
    metric: options.Metric = "psnr",
    results: options.Results = Path("results"),
    as_json: options.Json = False,
    plugin: options.Plugins = None,
    device: options.RowDevice = "",
    cost: Annotated[
        str,
        option(
            MEASUREMENT,
            "times of your device, of samples and methods, in place of those of the results: a "
            "name or a TOML file, as rlbench run --cost reads and rlbench speed --as-cost writes",
            value="COST",
        ),
    ] = "",
    strict: Annotated[
        bool,
        flag(MEASUREMENT, "--strict", "refuse an answer that uncertain times leave open, as in CI"),
    ] = False,
) -> None:
    """Name the denoiser with the least error in a frame time.

    Reads the results table alone: the expected score with its interval, the runner-up, and the
    cost of a sample and the deadline at which another method wins. Frame time is G-buffer +
    inference + samples. Where times are uncertain, the answer says by how much, and which other
    denoiser could be the best. The exit code is 2 if no denoiser fits, and with --strict if
    uncertain times leave the answer open.

    Examples:

    \b
      rlbench decide --sample-ms 4.2 --frame-ms 16.7
      rlbench decide --sample-ms 4.2 --frame-ms 33.3 --scenes city,hall --needs albedo,normal
      rlbench decide --sample-ms 26.3 --frame-ms 100 --results results/gpu --json
      rlbench decide --cost gpu.toml --frame-ms 16.7 --gbuffer-ms 1.5
    """
    load_plugins(plugin)
    from reports.decision_text import decision_text

    rows, left_out = read_rows(results, methods, scenes), list[str]()
    if needs is not None:
        rows, left_out = _select_by_inputs(rows, split_names(needs))
    decision = api.decide(
        frame_ms,
        sample_ms,
        rows,
        gbuffer_ms=gbuffer_ms,
        cost=cost,
        metric=metric,
        device=device,
        strict=strict,
        left_out=left_out,
        plugins=plugin_words(plugin),
    )
    if as_json:
        typer.echo(as_json_text(decision))
        return
    best = decision.candidates[0]
    run = _next_run(rows, best.method, best.spp, results)
    next_run = run and run + plugin_words(plugin)
    typer.echo(decision_text(decision, next_run))


def _next_run(rows: pd.DataFrame, method: str, spp: float, results: Path) -> str:
    """A command that measures twice the budget of a row; empty where none is known to work.

    It has to have the preset of the row, whose clips have so many samples, and its cost of a
    sample, which images made elsewhere have not; the weights of a row with a label are not known.
    """
    from rlbench.benchmark.results import RowName
    from rlbench.clips.presets import find_preset

    own = rows[rows["method"] == method]
    presets = [find_preset(name) for name in set(own["preset"])]
    sources = own.loc[own["metric"] == "sample_ms", "convention"]
    is_measured = not sources.empty and sources.str.contains(", measured on ").all()
    if (
        not is_measured
        or RowName.parse(method).label
        or len(presets) != 1
        or not presets[0]
        or 2 * spp > presets[0].pool_spp
    ):
        return ""
    return f"rlbench run -m {method} --spp {2 * spp:g} --preset {presets[0].name} --out {results}"


def _select_by_inputs(
    rows: pd.DataFrame, channels: Collection[str]
) -> tuple[pd.DataFrame, list[str]]:
    """The rows of methods that declare no other input than `channels`, and why others are left out.

    Raises OptionError for an unknown channel, and if no method is left.
    """
    from rlbench.clips.header import BUFFER_CHANNELS

    if unknown := [name for name in channels if name not in BUFFER_CHANNELS]:
        problem = f"--needs {','.join(unknown)}: no such G-buffer channel"
        raise OptionError(unknown_name(problem, unknown[0], BUFFER_CHANNELS))
    reasons = {method: _lacking(method, channels) for method in sorted(set(rows["method"]))}
    left_out = [f"{method} is left out: {reason}" for method, reason in reasons.items() if reason]
    if len(left_out) == len(reasons):
        raise OptionError(f"--needs {','.join(channels)} leaves no method: {'; '.join(left_out)}")
    return rows[rows["method"].map(reasons) == ""], left_out


def _lacking(method: str, channels: Collection[str]) -> str:
    """Why a method of the results cannot do with these channels alone; empty if it can."""
    from rlbench import registry
    from rlbench.benchmark.results import RowName

    try:
        inputs = registry.get_variant(RowName.parse(method).method_name).traits.inputs
    except registry.PluginError:
        return "it is not installed, so its inputs are not known; name its file with --plugin"
    return f"it needs {', '.join(missing)}" if (missing := sorted(inputs - set(channels))) else ""
