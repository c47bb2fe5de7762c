"""The command stress: how methods behave when their input is wrong, extreme or very long."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import options
from rlbench.cli.arguments import split_names
from rlbench.cli.methods import load_rows
from rlbench.cli.options import EXECUTION, flag, folder, option


def stress(
    context: typer.Context,
    methods: options.Methods = None,
    only: Annotated[
        list[str] | None,
        option(None, "sections a,b of those above; default: all of them", value="SECTIONS"),
    ] = None,
    quick: Annotated[
        bool, flag(None, "--quick", "shorter clips and fewer tests, seconds per method")
    ] = False,
    plugin: options.Plugins = None,
    weights: options.Weights = options.SHIPPED,
    device: options.Device = "cpu",
    restart: Annotated[
        bool, flag(EXECUTION, "--restart", "run again what the output folder holds")
    ] = False,
    out: Annotated[
        Path, folder("folder of stress.csv, stress.json and the results that a later call reuses")
    ] = Path("results/stress"),
) -> None:
    """Stress-test methods, with a verdict per test.

    It tests numerical stability: a test passes, is degraded or fails, by a figure and two limits.
    Learned methods run with their shipped weights, or --weights; rows without any are skipped.
    Results are stored per method and section, and reused while code and weights are the same. The
    exit code is 1 if a test failed. Whether a method reads the reference or samples that it did not
    draw is tested by rlbench check alone.

    Without --methods, every row that does not borrow the weights of another is tested. Sections of
    the suite itself (allocation, metrics, gradients) run without --methods or if --only names them.

    Sections: bad-pixel, budgets, allocation, long-runs, precision, transformations, lying-buffers,
    metrics, gradients, and those of plugins.

    Examples:

    \b
      rlbench stress
      rlbench stress -m ours,svgf --only bad-pixel
      rlbench stress -m mine --plugin mine.py --quick
      rlbench stress -m ours --weights ours=runs/ours/ours.safetensors
    """
    names = split_names(methods)
    load_rows(context, plugin, names or ["all"])
    from rlbench.benchmark.planning import select_device
    from rlbench.checks.stress.run import stress_methods
    from rlbench.system.paths import check_writable

    target = select_device(device)
    check_writable(out)
    has_passed = stress_methods(
        names, split_names(only), quick, target, out, restart, weights=weights.files_of
    )
    raise typer.Exit(0 if has_passed else 1)
