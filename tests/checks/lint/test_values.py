"""NaN, infinity and negative radiance."""

from __future__ import annotations

from dataclasses import replace

import torch

from rlbench.checks.lint.checks import lint_clip
from rlbench.checks.lint.clip_arrays import read_clip_arrays
from rlbench.checks.lint.values import check_finite
from rlbench.checks.result import Verdict
from tests.checks.lint.broken_fixtures import break_values, store


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
