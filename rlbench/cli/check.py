"""The command check: do methods keep the contract?"""

from __future__ import annotations

from typing import Annotated

import typer

from rlbench.cli import options
from rlbench.cli.json_output import ChecksOutput, print_json
from rlbench.cli.methods import load_rows, require_methods
from rlbench.cli.options import flag

__all__ = ["check"]


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
    from rlbench.benchmark.api import select_device
    from rlbench.checks.conformance.run import check_methods

    output = ChecksOutput() if as_json else None
    has_passed = check_methods(
        patterns, select_device(device), debug, output.add if output else None
    )
    if output:
        print_json(output)
    raise typer.Exit(0 if has_passed else 1)
