"""Pages: sections of tables and lists as Markdown and LaTeX, and a CSV of all their numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from reports.analysis.scores import Scores, scores_by_device
from reports.layout.files import slug, write_figure
from reports.layout.latex import PREAMBLE, escape, to_latex
from reports.layout.tables import Table, one_line, to_markdown
from rlbench.benchmark.results import MissingRowsError
from rlbench.system.store import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_LINES = 6  # of a list that is not folded
Drawing = tuple[Callable[[], "Figure"] | None, pd.DataFrame | None]  # a figure and its table


@dataclass(frozen=True)
class Section:
    """The part of a page about one device."""

    device: str
    tables: Sequence[Table]
    records: pd.DataFrame  # every number of the tables, for the CSV
    lists: Mapping[str, Sequence[str]] = field(default_factory=dict)  # title to lines; empty: none


def write_report(
    results: pd.DataFrame,
    folder: Path,
    name: str,
    title: str,
    section_of: Callable[[Scores], Section | None],
    missing: str = "",
) -> list[Path]:
    """Write `name`.md, .csv and .tex with the section of each device, and return the files.

    `section_of` takes the scores of a device; None leaves it out. Raises ReportError where a mean
    would mix rows that cannot be compared, and MissingRowsError with `missing` without a section.
    """
    sections = [part for scores in scores_by_device(results) if (part := section_of(scores))]
    if not sections:
        raise MissingRowsError(missing)
    return write_page(folder, name, title, results, sections)


def write_figures(
    results: pd.DataFrame,
    folder: Path,
    name: str,
    figures_of: Callable[[Scores], Mapping[str, Drawing]],
    metric: str = "psnr",
) -> list[Path]:
    """Write the figures of each device as PNG, PDF and SVG, and their tables as CSV.

    `figures_of` takes the scores of a device and returns, by what follows `name` in the names of
    the files, how to draw a figure, and its table. Names of several devices end with the device.
    Raises ReportError where a mean would mix rows that cannot be compared.
    """
    parts = [
        (s.device, found) for s in scores_by_device(results, metric) if (found := figures_of(s))
    ]
    files = []
    for device, figures in parts:
        end = "" if len(parts) == 1 else f"-{slug(device)}"
        for part, (draw, table) in figures.items():
            files += write_figure(draw, folder, f"{name}{part}{end}", table)
    return files


def write_page(
    folder: Path, name: str, title: str, results: pd.DataFrame, sections: Sequence[Section]
) -> list[Path]:
    """Write `name`.md, .csv and .tex with these sections, and return the files.

    The title names the clips of `results`, the last line of the page its runs. A note that tables
    share is printed once. Rows of the CSV have a column with their device.
    """
    parts, floats = [f"# {title}: {one_line(describe_clips(results))}\n"], [PREAMBLE]
    printed: set[str] = set()  # notes, in LaTeX
    for section in sections:
        notes = dict.fromkeys(table.note for table in section.tables if table.note)
        parts += [f"## {one_line(section.device) or 'Unnamed device'}\n"]
        parts += [f"{one_line(note)}\n" for note in notes]
        parts += [*map(to_markdown, section.tables), _format_lists(section.lists)]
        floats += [f"% {escape(section.device)}\n"]
        for table in section.tables:
            floats.append(to_latex(table, with_note=table.note not in printed))
            printed.add(table.note)
    runs = one_line(", ".join(sorted(set(results["run_id"]))))
    parts += [f"Runs: {runs}\n", *_describe_looks(results)]
    records = [section.records.assign(device=section.device) for section in sections]
    numbers: str = pd.concat(records or [pd.DataFrame()]).to_csv(index=False)
    texts = {"md": "\n".join(parts), "csv": numbers, "tex": "\n".join(floats)}
    files = [folder / f"{name}.{suffix}" for suffix in texts]
    for file, text in zip(files, texts.values(), strict=True):
        write_text(file, text)
    return files


def describe_clips(results: pd.DataFrame) -> str:
    """Preset, number and length of the clips: `preset mini, 4 clips of 8 frames`."""
    presets = sorted(set(results["preset"]) - {""})
    lengths = sorted(set(results[results["frame"] >= 0].groupby("clip")["frame"].nunique()))
    count = results["clip"].nunique()
    text = f"{count} clip{'s' * (count != 1)}"
    if lengths:
        length = f"{lengths[0]}" if len(lengths) == 1 else f"{lengths[0]} to {lengths[-1]}"
        text += f" of {length} frame{'s' * (length != '1')}"
    if presets:
        text = f"preset{'s' * (len(presets) > 1)} {' and '.join(presets)}, {text}"
    return text


def _describe_looks(results: pd.DataFrame) -> list[str]:
    """How often runs scored something new on these presets; empty where no ledger says."""
    looks = results.attrs.get("looks", {})
    counts = [f"{p} {looks[p]}" for p in sorted(set(results["preset"])) if p in looks]
    return [f"Looks at test clips (runs with new scores): {', '.join(counts)}\n"] if counts else []


def _format_lists(lists: Mapping[str, Sequence[str]]) -> str:
    sections = [
        f"### {one_line(title)}\n\n{_format_list(lines)}\n"
        for title, lines in lists.items()
        if lines
    ]
    return "\n".join(sections)


def _format_list(lines: Sequence[str]) -> str:
    """The lines; of many, the number, and the lines folded below it."""
    text = "\n".join(f"- {one_line(line)}" for line in lines)
    if len(lines) <= MAX_LINES:
        return text
    summary = f"<summary>{len(lines)} entries</summary>"
    return f'<details markdown="1">\n{summary}\n\n{text}\n\n</details>'
