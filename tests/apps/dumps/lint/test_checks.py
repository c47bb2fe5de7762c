"""A correct clip passes all checks, and each fault fails exactly its own; the command lint."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from rlbench.apps.dumps.lint.checks import check_finite, lint_clip
from rlbench.apps.dumps.lint.clip_arrays import read_clip_arrays
from rlbench.apps.dumps.lint.motion import check_motion
from rlbench.checks.result import Verdict
from rlbench.clips.stored import open_clip
from tests.apps.dumps.lint.broken_fixtures import FAULTS, break_values, correct_clip, store
from tests.cli.runner import rlbench

QUICK = (  # faults of one clip, which always run; each fault alone is slow
    {
        "motion": "y points up",
        "albedo": "it is sRGB",
        "sample independence": "two samples share half of their pixels",
        "reference halves": "they overlap",
    },
    {"depth": "it is the distance to the camera", "independent seeds": "half A contains the pool"},
    {"normal": "they are in camera space"},
    {"orientation": "the G-buffer is upside down"},
)
EACH = ({check: fault} for check, faults in FAULTS.items() for fault in faults)


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
    "faults", [*QUICK, *(pytest.param(each, marks=pytest.mark.slow) for each in EACH)], ids=str
)
def test_faults_fail_their_own_checks_and_no_other(arrays, tmp_path, faults):
    for check, fault in faults.items():
        arrays = FAULTS[check][fault](arrays)
    assert sorted(failed_checks(store(arrays, tmp_path / "faulty"))) == sorted(faults)


def test_a_failed_check_says_how_to_fix_it(arrays):
    found = check_motion(FAULTS["motion"]["it is in NDC"](arrays))
    assert found.remedy == "convert it from (x, y) in NDC (-1..1), to the previous frame"


def test_a_nan_fails_one_check_which_reports_its_place(arrays, tmp_path):
    faulty = store(arrays, tmp_path / "faulty")
    break_values(faulty, arrays)
    found = [f for f in lint_clip(read_clip_arrays(faulty)) if f.verdict is Verdict.FAILED]
    assert [f.check for f in found] == ["finite values"]
    assert "2 in reference A; first: reference A frame 1 at x 5, y 3" in found[0].found


def test_infinite_depth_psr_glass_is_background_too(arrays):
    behind = arrays.gbuffer["depth"].clone()
    behind[0, 0, 3, 4] = torch.inf
    more = replace(arrays, gbuffer={**arrays.gbuffer, "depth_psr": behind})
    assert check_finite(more).verdict is Verdict.PASSED
    assert more.sanitized.gbuffer["depth_psr"][0, 0, 3, 4] == torch.inf


def test_the_command_passes_and_writes_a_figure(folder, tmp_path):
    output = rlbench("lint", folder, "--figure", tmp_path / "figure.png", "--frames", 3)
    assert "failed: 0" in output
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_fails_where_a_check_does(arrays, tmp_path):
    store(FAULTS["reference halves"]["they are equal"](arrays), tmp_path / "clips" / "faulty")
    assert "both halves are the same image" in rlbench("lint", tmp_path / "clips", code=1)


def test_arrays_equal_those_of_the_clip_reader(arrays, folder):
    frame = open_clip(folder, seed=3).frame(2)
    read = read_clip_arrays(folder)
    assert torch.equal(read.gbuffer["motion"][2, None], frame.gbuffer.motion)
    assert torch.equal(read.reference[2, None] * 0.5, frame.reference.mean)
    assert len(read_clip_arrays(folder, 2)) == 2  # the requested frames alone
