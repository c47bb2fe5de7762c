"""What `rlbench doctor` says of the path tracers of this machine."""

from __future__ import annotations

from collections.abc import Iterator

from rlbench.apps.render.cycles import process
from rlbench.apps.render.mitsuba import variant
from rlbench.checks.result import CheckResult, not_applicable, passed, warning


def check_tracers() -> Iterator[CheckResult]:
    """The result of the check of Mitsuba, and of that of Cycles. Nothing is changed."""
    yield _check_mitsuba()
    yield _check_cycles()


def _check_mitsuba() -> CheckResult:
    report = variant.describe_variant().removeprefix("path tracer: ")
    if "scalar" in report.splitlines()[0]:
        found = report.removesuffix(variant.INSTALL_HINT).rstrip()
        return warning("path tracer", found, variant.INSTALL_HINT)
    return passed("path tracer", report)


def _check_cycles() -> CheckResult:
    version, python = process.bpy_version(), process.interpreter()
    if not version:
        found = f"not installed in {python}; a second path tracer for .blend, USD and glTF"
        return not_applicable("extra cycles", f"{found}: {process.INSTALL_HINT}")
    if version != process.TESTED_BPY_VERSION:
        found = f"bpy {version} in {python}; rlbench was tested with {process.TESTED_BPY_VERSION}"
        return warning("extra cycles", found, f"pip install bpy=={process.TESTED_BPY_VERSION}")
    return passed("extra cycles", f"bpy {version} in {python}")
