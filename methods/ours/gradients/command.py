"""The command line of an experiment: options with defaults, and examples."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

Options = Mapping[str, tuple[str | int | Path | bool, str]]  # defaults and lines of help


def make_parser(
    program: str,
    description: str,
    examples: Sequence[str],
    options: Options,
) -> argparse.ArgumentParser:
    """A parser whose options have the type of their default; False makes a switch.

    `examples` are the words behind the program.
    """
    parser = argparse.ArgumentParser(
        prog=program,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description=description,
        epilog="\n".join(["examples:", *(f"  {program} {words}" for words in examples)]),
    )
    for option, (default, line) in options.items():
        if isinstance(default, bool):
            parser.add_argument(option, action="store_true", help=line)
        else:
            kind = Path if isinstance(default, Path) else type(default)
            parser.add_argument(
                option,
                type=kind,
                default=default,
                help=f"{line} (default: {'none' if default == '' else default})",
            )
    return parser
