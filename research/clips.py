"""Clips and budgets of an experiment on the command line, and its table of gains."""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd
from rich.console import Console


def add_clips(parser: argparse.ArgumentParser) -> None:
    """Add arguments for clips and budgets, which `read_cells` reads."""
    parser.add_argument("clips", type=Path, nargs="+", help="folders of clips")
    parser.add_argument("--spp", default="1", help="samples per pixel, a,b (default: 1)")


def read_cells(
    parser: argparse.ArgumentParser, arguments: argparse.Namespace
) -> list[tuple[Path, float]]:
    """Each clip with each budget; exits with a message where a folder holds no clip."""
    if missing := [str(f) for f in arguments.clips if not (f / "clip.toml").is_file()]:
        parser.error(f"no clip in {', '.join(missing)}: a folder with a clip.toml is needed")
    budgets = [float(spp) for spp in arguments.spp.split(",")]
    return [(folder, spp) for folder in arguments.clips for spp in budgets]


def print_gains(title: str, table: pd.DataFrame) -> None:
    """Print a table of gains in dB, a column for each budget, as Markdown."""
    console = Console()
    console.print(f"| {title} | " + " | ".join(f"{spp:g} spp" for spp in table.columns) + " |")
    console.print("| --- |" + " ---: |" * len(table.columns))
    for name, row in table.iterrows():
        console.print(f"| {name} | " + " | ".join(f"{gain:+.2f}" for gain in row) + " |")
