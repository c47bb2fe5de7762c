"""The page of overhead: stages exclude one another and add up to the run."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from tests.performance.profile_run import REST, STAGES, StageClock, table
from tests.procedural_folder import write_world


def test_a_stage_inside_another_is_taken_off_the_outer_one():
    ticks = iter([0.0, 1.0, 3.0, 7.0, 8.0, 10.0])
    clock = StageClock(lambda: next(ticks))
    with clock.running("outer"), clock.running("inner"):
        pass
    clock.stop()
    assert dict(clock.seconds) == {REST.name: 1 + 2, "outer": 2 + 1, "inner": 4}


def test_the_last_lines_are_the_shares_of_scoring_and_of_the_suite():
    clock = StageClock(lambda: 0.0)
    clock.seconds |= {stage.name: 1.0 for stage in STAGES} | {"frames of methods": 93.0}
    shares = dict(re.findall(r"\| \*\*(\w+)\*\*.*? ([\d.]+ %) \| 5 % \|", table([clock, clock])))
    of_suite = sum(stage.owner == "suite" for stage in STAGES)
    total = 93 + len(STAGES) - 1
    assert shares == {"scoring": f"{100 / total:.1f} %", "suite": f"{100 * of_suite / total:.1f} %"}


@pytest.mark.slow
def test_the_page_of_a_run_has_its_command_and_every_stage(tmp_path):
    write_world(tmp_path / "clips" / "world")
    words = ["-m", "mean", "--spp", "1", "--clips", tmp_path / "clips", "--out", tmp_path / "r"]
    command = [sys.executable, "-m", "tests.performance.profile_run", tmp_path / "page.md", *words]
    subprocess.run(command, check=True, capture_output=True)
    page = (tmp_path / "page.md").read_text()
    assert "`rlbench run -m mean --spp 1" in page
    (scored,) = re.findall(r"\| metrics \| metrics \| ([\d.]+) \|", page)
    assert float(scored) > 0
    assert all(f"| {stage.name} |" in page for stage in STAGES)
