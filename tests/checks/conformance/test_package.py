"""`rlbench.checks.conformance` is all that the tests of a plugin need, and imports lazily."""

from __future__ import annotations

import doctest
import subprocess
import sys
import textwrap

import pytest

from rlbench import registry
from rlbench.checks import conformance, result
from rlbench.checks.conformance import suite
from rlbench.checks.lint import motion
from tests.conftest import write_plugin


def documented_test(method: str) -> str:
    """The test of the package's docstring, for another method."""
    documentation = conformance.__doc__ or ""
    start, end = documentation.index("    import pytest"), documentation.index("`method` runs once")
    return textwrap.dedent(documentation[start:end]).replace('"mean"', f'"{method}"')


class Outcomes:
    """A pytest plugin that collects the outcome and the text of each test."""

    def __init__(self):
        self.outcomes: list[tuple[str, str]] = []

    def pytest_runtest_logreport(self, report):
        if report.when == "call":
            self.outcomes.append((report.outcome, report.longreprtext))


def run_documented_test(tmp_path, method: str, **plugin: str) -> list[tuple[str, str]]:
    registry.use_plugin(write_plugin(tmp_path / f"{method}.py", method, **plugin))
    file = tmp_path / f"test_{method}.py"  # pytest imports each file name only once
    file.write_text(documented_test(method))
    outcomes = Outcomes()
    options = ["-q", "-p", "no:cacheprovider", "--import-mode=importlib", f"--rootdir={tmp_path}"]
    pytest.main([str(file), *options], [outcomes])
    return outcomes.outcomes


def test_the_documented_lines_run_one_test_per_check(tmp_path):
    outcomes = run_documented_test(tmp_path, "correct")
    assert [outcome for outcome, _ in outcomes] == ["passed"] * len(conformance.CHECKS)


def test_the_documented_lines_fail_with_what_was_found_and_how_to_fix_it(tmp_path):
    outcomes = run_documented_test(tmp_path, "double", body="return samples.mean.double(), None")
    (text,) = [text for outcome, text in outcomes if outcome == "failed"]
    assert "found torch.float64" in text
    assert "-> end with .float()" in text


def test_importing_the_package_does_not_import_torch():
    code = "import sys, rlbench.checks.conformance; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("name", conformance.__all__)
def test_every_public_name_can_be_imported(name):
    assert getattr(conformance, name) is not None
    assert name in dir(conformance)


@pytest.mark.parametrize("module", [conformance, result, suite, motion])
def test_examples_of_docstrings_run(module):
    names = {"MethodUnderTest": conformance.MethodUnderTest}
    found = doctest.testmod(module, extraglobs=names)
    assert found.attempted > 0
    assert found.failed == 0
