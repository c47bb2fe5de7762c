"""The regression check as Markdown, for pull requests, and as JUnit XML, for servers.

The elements and attributes of the XML are those of the schema of Ant's JUnit reports (Windy Road,
JUnit.xsd), the strictest in use; servers that expect less read them too.
"""

from __future__ import annotations

import os
import platform
import re
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

from rlbench.benchmark.regression.comparison import (
    COLUMNS,
    FAILING,
    SLOWER,
    BaselineDiff,
    RegressionReport,
    SpeedResult,
)
from rlbench.benchmark.regression.crops import Crops
from rlbench.system import paths
from rlbench.system.store import write_text

JOB_SUMMARY = "GITHUB_STEP_SUMMARY"  # a file whose Markdown GitHub shows with a job
SUITE = "rlbench.regress"
UNCOMPARED = ("new", "skipped")
UNPRINTABLE = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # in XML 1.0


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
    write_text(file, markdown(report, crops, Path(images).as_posix()))


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


def write_junit(report: RegressionReport, file: Path, when: datetime | None = None) -> None:
    """Write a test case for each cell and each speed gate; `when` is now by default.

    A worse or missing cell and a gate that was exceeded are failures, whose message has what was
    expected, measured and allowed. Cells without an entry, and those of a subset without a result,
    are skipped, as are gates whose times cannot be believed.
    """
    cases = [*map(_cell_case, report.diffs), *map(_speed_case, report.speed)]
    suite = ElementTree.Element(
        "testsuite",
        package="rlbench",
        id="0",
        name=SUITE,
        timestamp=(when or datetime.now(UTC)).strftime("%Y-%m-%dT%H:%M:%S"),
        hostname=platform.node() or "localhost",
        tests=str(len(cases)),
        failures=str(_count(cases, "failure")),
        errors="0",
        skipped=str(_count(cases, "skipped")),
        time="0",
    )
    ElementTree.SubElement(suite, "properties")
    suite.extend(cases)
    ElementTree.SubElement(suite, "system-out").text = _text(report.text())
    ElementTree.SubElement(suite, "system-err")
    root = ElementTree.Element("testsuites")
    root.append(suite)
    ElementTree.indent(root)
    with paths.atomic_write(file) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _cell_case(diff: BaselineDiff) -> ElementTree.Element:
    key = diff.key
    case = _case(f"{SUITE}.{key.method}", f"{key.scene} at {key.target_spp:g} spp")
    if diff.verdict in FAILING:
        _add(case, "failure", _message(diff), diff.verdict)
    elif diff.verdict in UNCOMPARED:
        reason = "no entry in the baseline" if diff.verdict == "new" else "not measured"
        _add(case, "skipped", reason)
    return case


def _speed_case(result: SpeedResult) -> ElementTree.Element:
    case = _case(f"{SUITE}.speed", f"{result.gate.row} / {result.gate.reference}")
    if result.verdict == SLOWER:
        _add(case, "failure", str(result), result.verdict)
    elif result.reason:
        _add(case, "skipped", str(result))
    return case


def _message(diff: BaselineDiff) -> str:
    expected = f"expected {diff.expected:.3f} dB"
    if diff.measured is None:
        return f"{expected}, measured nothing"
    return (
        f"{expected}, measured {diff.measured:.3f} dB ({diff.change:+.3f}), "
        f"allowed fall {diff.tolerance_db:.3f} dB"
    )


def _case(class_name: str, name: str) -> ElementTree.Element:
    return ElementTree.Element("testcase", classname=_text(class_name), name=_text(name), time="0")


def _add(case: ElementTree.Element, tag: str, message: str, kind: str = "") -> None:
    attributes = {"message": _text(message)} | ({"type": kind} if kind else {})
    ElementTree.SubElement(case, tag, attributes).text = _text(message)


def _count(cases: list[ElementTree.Element], tag: str) -> int:
    return sum(case.find(tag) is not None for case in cases)


def _text(text: str) -> str:
    """Text without the characters that XML cannot hold."""
    return UNPRINTABLE.sub("?", text)
