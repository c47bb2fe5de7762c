"""Pages: sections of tables and lists as Markdown and LaTeX, and a CSV of all their numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from reports.layout.latex import PREAMBLE, to_latex
from reports.layout.tables import Table, to_markdown

__all__ = ["Section", "describe_clips", "write_page"]

MAX_LINES = 6  # of a list that is not folded


@dataclass(frozen=True)
class Section:
    """The part of a page about one device."""

    device: str
    tables: Sequence[Table]
    records: pd.DataFrame  # every number of the tables, for the CSV
    lists: Mapping[str, Sequence[str]] = field(default_factory=dict)  # title to lines; empty: none


def write_page(
    folder: Path, name: str, title: str, results: pd.DataFrame, sections: Sequence[Section]
) -> list[Path]:
    """Write `name`.md, .csv and .tex with a section for each device, and return the files.

    The title names the clips of `results`, the last line of the page its runs. A note that tables
    share is printed once. Rows of the CSV have a column with their device.
    """
    parts, floats = [f"# {title}: {describe_clips(results)}\n"], [PREAMBLE]
    printed: set[str] = set()  # notes, in LaTeX
    for section in sections:
        notes = dict.fromkeys(table.note for table in section.tables if table.note)
        parts += [f"## {section.device or 'Unnamed device'}\n", *(f"{note}\n" for note in notes)]
        parts += [*map(to_markdown, section.tables), _format_lists(section.lists)]
        floats += [f"% {section.device}\n"]
        for table in section.tables:
            floats.append(to_latex(table, with_note=table.note not in printed))
            printed.add(table.note)
    parts += [f"Runs: {', '.join(sorted(set(results['run_id'])))}\n", *_describe_looks(results)]
    records = [section.records.assign(device=section.device) for section in sections]
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{name}.{suffix}" for suffix in ("md", "csv", "tex")]
    files[0].write_text("\n".join(parts), encoding="utf-8")
    pd.concat(records or [pd.DataFrame()]).to_csv(files[1], index=False)
    files[2].write_text("\n".join(floats), encoding="utf-8")
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
        f"### {title}\n\n{_format_list(lines)}\n" for title, lines in lists.items() if lines
    ]
    return "\n".join(sections)


def _format_list(lines: Sequence[str]) -> str:
    """The lines; of many, the number, and the lines folded below it."""
    text = "\n".join(f"- {line}" for line in lines)
    if len(lines) <= MAX_LINES:
        return text
    summary = f"<summary>{len(lines)} entries</summary>"
    return f'<details markdown="1">\n{summary}\n\n{text}\n\n</details>'
