"""The regression check as JUnit XML, which continuous-integration servers read.

The elements and attributes are those of the schema of Ant's JUnit reports (Windy Road, JUnit.xsd),
the strictest in use; servers that expect less read them too.
"""

from __future__ import annotations

import platform
import re
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

from rlbench.benchmark.regression.comparison import FAILING, BaselineDiff, RegressionReport
from rlbench.benchmark.regression.speed_gate import SLOWER, SpeedResult
from rlbench.system import paths

__all__ = ["write_junit"]

SUITE = "rlbench.regress"
UNCOMPARED = ("new", "skipped")
UNPRINTABLE = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # in XML 1.0


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
