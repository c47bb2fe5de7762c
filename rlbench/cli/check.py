"""The command check: whether methods keep the contract."""

from __future__ import annotations

from typing import Annotated

import typer

from rlbench.cli import options
from rlbench.cli.json_output import show_checks
from rlbench.cli.methods import load_rows, require_methods
from rlbench.cli.options import flag


def check(
    context: typer.Context,
    methods: options.Methods = None,
    plugin: options.Plugins = None,
    device: options.Device = "cpu",
    debug: Annotated[
        bool, flag(None, "--debug", "print the traceback of an exception of a method")
    ] = False,
    as_json: options.Json = False,
) -> None:
    """Check that methods keep the contract.

    Each line is a check that passed, failed (with a remedy), or does not apply (-). The checks run
    on a small closed-form clip, with random weights, so they say nothing about quality. The exit
    code is 1 if a check failed.

    Examples:

    \b
      rlbench check -m ours
      rlbench check -m bright --plugin bright.py
      rlbench check -m bright --plugin bright.py --debug
      rlbench check -m all
    """
    patterns = require_methods(methods)
    load_rows(context, plugin, patterns)
    from rlbench.benchmark.planning import select_device
    from rlbench.checks.conformance.run import check_methods

    rows = show_checks(check_methods(patterns, select_device(device)), as_json, debug)
    failed = [row["name"] for row in rows if not row["passed"]]
    if not as_json:
        summary = f"failed: {', '.join(failed)}" if failed else "none failed"
        typer.echo(f"{len(rows)} method{'s' * (len(rows) != 1)} checked; {summary}")
    raise typer.Exit(bool(failed))
