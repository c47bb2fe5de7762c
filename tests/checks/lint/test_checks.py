"""A correct clip passes all checks, and each fault fails exactly its own check."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.checks.lint.checks import lint_clip
from rlbench.checks.lint.clip_arrays import read_clip_arrays
from rlbench.checks.result import Verdict
from tests.checks.lint.broken_fixtures import FAULTS, correct_clip, store

QUICK = (  # one of each module runs always, all of them when slow tests do
    "y of motion points up",
    "depth is the distance to the camera",
    "normals are in camera space",
    "albedo is sRGB",
    "the G-buffer is upside down",
    "two samples share half of their pixels",
    "half A contains the pool",
    "the halves overlap",
)


def failed_checks(folder: Path) -> list[str]:
    return [f.check for f in lint_clip(read_clip_arrays(folder)) if f.verdict is Verdict.FAILED]


def test_a_correct_clip_passes_every_check(folder):
    found = lint_clip(read_clip_arrays(folder))
    assert {f.check: f.found for f in found if f.verdict is not Verdict.PASSED} == {}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_other_correct_clips_fail_no_check(tmp_path, seed):
    assert failed_checks(store(correct_clip(seed), tmp_path / "correct")) == []


@pytest.mark.parametrize(
    "fault",
    [f if f in QUICK else pytest.param(f, marks=pytest.mark.slow) for f in FAULTS],
)
def test_a_fault_fails_its_own_check_and_no_other(arrays, tmp_path, fault):
    check, break_clip = FAULTS[fault]
    assert failed_checks(store(break_clip(arrays), tmp_path / "faulty")) == [check]


def test_a_failed_check_says_how_to_fix_it(arrays, tmp_path):
    faulty = store(FAULTS["motion is in NDC"][1](arrays), tmp_path / "faulty")
    (found,) = (f for f in lint_clip(read_clip_arrays(faulty)) if f.verdict is Verdict.FAILED)
    assert found.remedy == "convert it from (x, y) in NDC (-1..1), to the previous frame"
