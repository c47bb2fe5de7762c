"""Pages: sections of tables and lists as Markdown and LaTeX, and a CSV of all their numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from reports.layout.tables import Grid, latex, markdown


@dataclass(frozen=True)
class Section:
    """What a page says of one device."""

    device: str
    grids: Sequence[Grid]
    records: pd.DataFrame  # every number of the grids, for the CSV
    lists: Mapping[str, Sequence[str]] = field(default_factory=dict)  # title: lines; none: no list


def write(
    folder: Path, name: str, heading: str, table: pd.DataFrame, sections: Sequence[Section]
) -> list[Path]:
    """The files `name`.md, .csv and .tex, a section for each device; CSV rows name theirs.

    The title says of which clips the table is, the last line of which runs.
    """
    pages, floats = [f"# {heading}: {clips(table)}\n"], []
    for section in sections:
        pages += [f"## {section.device or 'Device not named'}\n"]
        pages += [*map(markdown, section.grids), _lists(section.lists)]
        floats += [f"% {section.device}\n", *map(latex, section.grids)]
    pages += [f"Runs: {', '.join(sorted(set(table['run_id'])))}\n"]
    records = [section.records.assign(device=section.device) for section in sections]
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{name}.{kind}" for kind in ("md", "csv", "tex")]
    files[0].write_text("\n".join(pages), encoding="utf-8")
    pd.concat(records or [pd.DataFrame()]).to_csv(files[1], index=False)
    files[2].write_text("\n".join(floats), encoding="utf-8")
    return files


def clips(table: pd.DataFrame) -> str:
    """The clips whose rows these are: `preset mini, 4 clips of 8 frames`."""
    presets = sorted(set(table["preset"]) - {""})
    frames = sorted(set(table[table["frame"] >= 0].groupby("clip")["frame"].nunique()))
    count = table["clip"].nunique()
    told = f"{count} clip{'s' * (count != 1)}"
    if frames:
        many = f"{frames[0]}" if len(frames) == 1 else f"{frames[0]} to {frames[-1]}"
        told += f" of {many} frame{'s' * (many != '1')}"
    if presets:
        told = f"preset{'s' * (len(presets) > 1)} {' and '.join(presets)}, {told}"
    return told


def _lists(lists: Mapping[str, Sequence[str]]) -> str:
    sections = [
        f"### {title}\n\n" + "\n".join(f"- {line}" for line in lines) + "\n"
        for title, lines in lists.items()
        if lines
    ]
    return "\n".join(sections)
