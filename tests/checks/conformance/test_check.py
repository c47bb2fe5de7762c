"""A sound method is all green, and each planted fault turns exactly its own claim red."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from rlbench import registry
from rlbench.checks.conformance.checks import CHECKS
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.conformance.suite import run_checks
from rlbench.checks.result import Verdict
from rlbench.cli.app import app
from tests.checks.conformance.broken_fixtures import FAULTS, LESSER, SIZE
from tests.conftest import write_plugin


@pytest.fixture(autouse=True)
def _planted(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(registry.VARIABLE, "plants=tests.checks.conformance.broken_fixtures:FAMILY")


def told(name: str) -> dict[str, Verdict]:
    subject = MethodUnderTest(f"plants/{name}", size=SIZE, lesser=LESSER)
    return {claim.name: finding.verdict for claim, finding in run_checks(subject)}


def red(name: str) -> list[str]:
    return [claim for claim, verdict in told(name).items() if verdict is Verdict.FAILS]


@pytest.mark.parametrize(("name", "moot"), [("sound", {"uniform", "temporal"}), ("still", set())])
def test_of_a_sound_method_every_claim_holds_that_applies(name, moot):
    found = told(name)
    assert {claim for claim in found if found[claim] is not Verdict.HOLDS} == moot
    assert all(found[claim] is Verdict.MOOT for claim in moot)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_turns_its_own_claim_red_and_no_other(fault):
    assert red(fault) == [FAULTS[fault].claim]


@pytest.mark.parametrize("claim", CHECKS)
def test_every_claim_has_a_fault_that_it_finds(claim):
    assert claim in {fault.claim for fault in FAULTS.values()}


def rlbench(*words: object, code: int) -> list[str]:
    found = CliRunner().invoke(app, [str(word) for word in words])
    assert found.exit_code == code, found.output
    return found.output.splitlines()


def test_a_strangers_method_is_ticked_claim_by_claim(tmp_path):
    plugin = write_plugin(tmp_path / "mine.py", "mine")
    lines = rlbench("check", "mine/B1", "--plugin", plugin, code=0)
    assert lines[0] == "mine/B1"
    assert lines[1 : len(CHECKS) + 1] == [f"  ✓ {claim.sentence}" for claim in CHECKS.values()]
    assert lines[-1] == "1 methods were checked, none unsound"


def test_what_fails_is_told_with_what_was_found_and_what_would_do(tmp_path):
    plugin = write_plugin(tmp_path / "mine.py", "mine", traits="needs=frozenset({'depth'})")
    (line,) = [line for line in rlbench("check", "mine", "--plugin", plugin, code=1) if "✗" in line]
    assert line == (
        "  ✗ it reads exactly the view buffers that it declares: it reads none, and declares depth "
        "-> declare in Traits(inputs=...) what it reads"
    )


def test_what_a_method_raises_is_told_with_its_place(tmp_path):
    plugin = write_plugin(tmp_path / "mine.py", "mine", body="return 1 / 0, None")
    lines = rlbench("check", "mine", "--plugin", plugin, code=1)
    (line,) = [line for line in lines if "✗" in line]
    place = plugin.read_text().splitlines().index("        return 1 / 0, None") + 1
    assert f"ZeroDivisionError: division by zero (mine.py, line {place})" in line
    assert sum("cannot be told unless it runs on frames" in line for line in lines) == 20


ABSENT = {
    "a package": {"build": "import a_package_of_nobody"},
    "a pool": {"traits": "pool='of nobody'"},
    "a buffer": {"traits": "needs=frozenset({'weather'})"},
}


@pytest.mark.parametrize("what", ABSENT)
def test_a_method_that_lacks_something_here_is_no_fault_of_it(tmp_path, what):
    plugin = write_plugin(tmp_path / "mine.py", "mine", **ABSENT[what])
    lines = rlbench("check", "mine", "--plugin", plugin, code=0)
    assert lines[1].startswith("  - ")
    assert {"a package": "a_package_of_nobody", "a pool": "of nobody", "a buffer": "weather"}[
        what
    ] in lines[1]
    assert len(lines) == 3


def test_samples_of_the_world_stand_for_any_pool_that_is_installed(tmp_path, monkeypatch):
    installed = tmp_path / "chains-1.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: chains\nVersion: 1\n")
    (installed / "entry_points.txt").write_text("[rlbench.pools]\nchains = chains:POOL\n")
    kind = 'from rlbench.pools import PoolKind\nPOOL = PoolKind("chains", "of reservoirs")\n'
    (tmp_path / "chains.py").write_text(kind)
    monkeypatch.syspath_prepend(tmp_path)
    plugin = write_plugin(tmp_path / "mine.py", "mine", traits="pool='chains'")
    assert "1 methods were checked, none unsound" in rlbench(
        "check", "mine", "--plugin", plugin, code=0
    )
    assert not MethodUnderTest("mine").absent


def test_a_pilot_pass_is_no_fault(tmp_path):
    traits = "adaptive=True, passes=(0.25, 1.0), fresh=True, floor=1, spp=(4.0, 8.0)"
    plugin = write_plugin(tmp_path / "mine.py", "mine", traits=traits)
    rlbench("check", "mine", "--plugin", plugin, code=0)


def test_a_family_that_cannot_be_loaded_is_unsound(tmp_path, monkeypatch):
    monkeypatch.setattr("rlbench.checks.conformance.run.subjects", lambda patterns, device: [])
    (tmp_path / "torn.py").write_text("1 / 0")
    lines = rlbench("check", "all", "--plugin", tmp_path / "torn.py", code=1)
    assert "  ✗ it can be loaded: ZeroDivisionError: division by zero" in lines
