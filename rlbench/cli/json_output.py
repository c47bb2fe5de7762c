"""What commands print with --json: one document, alone on standard output.

The keys are those of the dataclasses below; docs/how-to/use-the-command-line.md lists them. Keys
may be added, none is renamed or removed without a note in the changelog. Numbers that are not
finite are null.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import typer

from rlbench.checks.result import CheckResult, Verdict

if TYPE_CHECKING:
    from pathlib import Path

    from rlbench.benchmark.cache_entries import CacheEntry
    from rlbench.benchmark.run_outcome import RunOutcome


@dataclass(frozen=True)
class RunOutput:
    """Output of `rlbench run --json`."""

    passed: bool  # no cell failed, all images are finite, and there are numbers
    verdict: str  # the same in a sentence
    results: str  # the results folder
    cells: dict[
        str, int
    ]  # number of cells by what happened to them: measured, cached, skipped, ...
    scores: list[dict[str, Any]]
    # method, spp, clips, psnr, psnr_debiased, inference_ms, frame_ms, and the uncertainty of both
    failed: list[str]  # cells that an error stopped
    nonfinite: list[dict[str, Any]]  # cell, frame, pixels, of_pixels
    missing: list[str]  # why clips have no score or no sample time
    remarks: list[str]  # uncertain times, and what to know of scores


@dataclass(frozen=True)
class ReportOutput:
    """Output of `rlbench report --json`."""

    files: list[str] = field(default_factory=list)  # written
    skipped: dict[str, str] = field(default_factory=dict)  # reason by report
    failed: dict[str, str] = field(default_factory=dict)  # error by report


@dataclass(frozen=True)
class ChecksOutput:
    """Output of `rlbench check`, `lint` and `doctor` with --json."""

    passed: bool  # no check failed
    checked: list[dict[str, Any]]
    # name of the method, clip or machine, passed, and checks: check, verdict, found, remedy


@dataclass(frozen=True)
class CacheOutput:
    """Output of `rlbench cache --json`: what there is, or with prune what is removed."""

    folder: str
    entries: list[dict[str, Any]]  # kind, name, preset, files, bytes, last_used, remade_by
    unknown: list[str]  # files that rlbench does not know and never removes

    @classmethod
    def of(
        cls, folder: Path, entries: Iterable[CacheEntry], unknown: Iterable[Path]
    ) -> CacheOutput:
        """The document of these entries; times are UTC in ISO 8601."""
        rows = [
            {
                "kind": entry.kind,
                "name": entry.name,
                "preset": entry.preset,
                "files": len(entry.files),
                "bytes": entry.bytes,
                "last_used": datetime.fromtimestamp(entry.last_used, UTC).isoformat(
                    timespec="seconds"
                ),
                "remade_by": entry.remade_by,
            }
            for entry in entries
        ]
        return cls(str(folder), rows, [str(file) for file in unknown])

    def groups(self) -> dict[str, list[dict[str, Any]]]:
        """The entries by kind, clips by preset too."""
        groups: dict[str, list[dict[str, Any]]] = {}
        for entry in self.entries:
            title = f"{entry['kind']} of {entry['preset']}" if entry["preset"] else entry["kind"]
            groups.setdefault(title, []).append(entry)
        return groups


@dataclass(frozen=True)
class ScenesOutput:
    """Output of `rlbench scenes --json`: scenes by others, or with get those that were got."""

    scenes: list[dict[str, Any]]
    # name, title, author, licence, source, preset, repository, commit, folder, files, bytes,
    # has_unknown_sizes, state, scene, missing
    failed: dict[str, str] = field(default_factory=dict)  # error by scene


@dataclass(frozen=True)
class FileScoresOutput:
    """Output of `rlbench score IMAGE REFERENCE --json`."""

    image: str
    reference: str
    scores: list[dict[str, Any]]  # metric, value, unit, better, convention
    remarks: list[str]


def run_output(outcome: RunOutcome) -> RunOutput:
    """The document of a run."""
    summary, verdict = outcome.summary, outcome.verdict
    counted = ("measured", "cached", "skipped", "failed", "timed", "unscored", "replaced")
    nonfinite = [
        {"cell": str(n.cell), "frame": n.frame, "pixels": n.pixels, "of_pixels": n.of_pixels}
        for n in verdict.nonfinite
    ]
    return RunOutput(
        passed=verdict.has_passed,
        verdict=str(verdict),
        results=str(outcome.folder),
        cells={name: getattr(summary, name) for name in counted},
        scores=[asdict(row) for row in outcome.scores],
        failed=[str(cell) for cell in verdict.failed],
        nonfinite=nonfinite,
        missing=outcome.missing,
        remarks=outcome.remarks,
    )


def show_checks(
    checked: Iterable[tuple[str, Iterable[CheckResult]]], as_json: bool, debug: bool = False
) -> list[dict[str, Any]]:
    """Print a tick list of each method, clip or machine as checks are made, or JSON in the end.

    Returns the rows of ChecksOutput. `debug` prints tracebacks too.
    """
    from rich.console import Console

    from rlbench.checks.console import print_results

    rows = []
    for name, results in checked:
        checks = print_results(results, Console(quiet=as_json), name, debug)
        lines = [
            {"check": c.check, "verdict": c.verdict.value, "found": c.found, "remedy": c.remedy}
            for c in checks
        ]
        passed = all(each.verdict is not Verdict.FAILED for each in checks)
        rows.append({"name": name, "passed": passed, "checks": lines})
    if as_json:
        print_json(ChecksOutput(all(row["passed"] for row in rows), rows))
    return rows


def as_json_text(answer: Any) -> str:
    """An answer as indented JSON, for scripts."""
    import msgspec

    # msgspec writes numbers that are not finite as null
    return msgspec.json.format(msgspec.json.encode(answer), indent=1).decode()


def print_json(answer: Any) -> None:
    """Print an answer as JSON."""
    typer.echo(as_json_text(answer))
