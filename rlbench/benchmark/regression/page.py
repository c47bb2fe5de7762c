"""The regression check as Markdown, for pull requests: result, lines that differ, and crops."""

from __future__ import annotations

import os
from pathlib import Path

from rlbench.benchmark.regression.comparison import COLUMNS, RegressionReport
from rlbench.benchmark.regression.crops import Crops
from rlbench.system import paths

__all__ = ["append_to_job_summary", "markdown", "write_summary"]

JOB_SUMMARY = "GITHUB_STEP_SUMMARY"  # a file whose Markdown GitHub shows with a job


def markdown(report: RegressionReport, crops: Crops | str = "", images: str = "") -> str:
    """The report as Markdown. `crops` are those of the worst change, or why there are none.

    `images` is the folder of the crops as a link from the page; without it they are only named,
    where a page cannot show files beside it.
    """
    parts = ["## rlbench regress", f"**{report.summary}**"]
    if report.shown:
        head = [column or "verdict" for column in COLUMNS]
        aligned = [":--" if index < 3 else "--:" for index in range(len(head))]
        rows = [head, aligned, *(list(diff.cells) for diff in report.shown)]
        parts += [
            "PSNR in dB; +- is the standard error over frames, allowed the largest fall.",
            "\n".join(f"| {' | '.join(map(_escape, row))} |" for row in rows),
        ]
    parts += ["\n".join(f"- {_escape(str(result))}" for result in report.speed)] * bool(
        report.speed
    )
    if isinstance(crops, Crops):
        parts += [f"### Worst change: {_escape(crops.title)}", _crop_table(crops, images)]
    elif crops:
        parts.append(f"No crops of the worst change: {_escape(crops)}")
    return "\n\n".join(parts) + "\n"


def write_summary(report: RegressionReport, crops: Crops | str, file: Path) -> None:
    """Write the report as Markdown, with links to crops that lie in a folder beside the file."""
    images = os.path.relpath(crops.folder, file.parent) if isinstance(crops, Crops) else ""
    with paths.atomic_write(file) as temporary:
        temporary.write_text(markdown(report, crops, Path(images).as_posix()), encoding="utf-8")


def append_to_job_summary(report: RegressionReport, crops: Crops | str) -> None:
    """Append the report to the summary of a GitHub job, where this is one.

    Such a page shows no files of the job, so the crops are named and left to its artefacts.
    """
    if file := os.environ.get(JOB_SUMMARY):
        with Path(file).open("a", encoding="utf-8") as summary:
            summary.write(markdown(report, crops))


def _crop_table(crops: Crops, images: str) -> str:
    names = list(crops.files)
    if not images:
        return f"Crops ({', '.join(names)}) are in the artefacts of this run: `{crops.folder.name}`"
    links = [f"![{name}]({images}/{file.name})" for name, file in crops.files.items()]
    lines = [names, ["---"] * len(names), links]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _escape(text: str) -> str:
    return text.replace("|", "\\|")
