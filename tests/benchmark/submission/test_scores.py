"""PSNR of a submission against other scores, and measured again."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import pytest

from rlbench.benchmark.regression.baseline import update_baseline
from rlbench.benchmark.results import read
from rlbench.benchmark.submission.score_checks import (
    check_against_scores,
    measure_again,
    select_cells,
)
from rlbench.checks.result import Verdict
from rlbench.errors import RlbenchError


def shift(submission, decibels):
    """All PSNR higher by some decibels."""
    cells = [
        replace(
            cell,
            scores={
                **cell.scores,
                "psnr": tuple(value + decibels for value in cell.scores.get("psnr", ())),
            },
        )
        for cell in submission.cells
    ]
    return replace(submission, cells=tuple(cells))


@pytest.fixture
def baseline(submitted, tmp_path):
    table = read(submitted.results)
    update_baseline(
        table[~((table["method"] == "svgf") & (table["target_spp"] == 0.5))], tmp_path / "b.json"
    )
    return str(tmp_path / "b.json")


def test_scores_agree_with_their_results_and_with_their_baseline(submitted, baseline):
    for source in (str(submitted.results), baseline):
        result = check_against_scores(submitted.submission, source)
        assert (result.verdict, result.found) == (Verdict.PASSED, "6 cells agree, 0 are new")


@pytest.mark.parametrize("decibels", [0.2, -0.2])
def test_scores_that_differ_in_either_direction_fail(submitted, baseline, decibels):
    for source in (str(submitted.results), baseline):
        result = check_against_scores(shift(submitted.submission, decibels), source)
        assert result.verdict is Verdict.FAILED
        assert "6 of 6 cells differ by more than allowed" in result.found


def test_a_baseline_of_another_preset_is_refused(submitted):
    with pytest.raises(RlbenchError, match="the results are of preset none, the baseline of mini"):
        check_against_scores(submitted.submission, "mini")


def test_cells_are_drawn_at_random_from_those_that_can_be_measured(submitted):
    cells = [replace(cell, method="stranger") for cell in submitted.submission.cells[:4]]
    mixed = replace(submitted.submission, cells=(*cells, *submitted.submission.cells[4:]))
    drawn = [select_cells(mixed, 1, Random(seed))[0] for seed in range(20)]
    assert {cell.method for cell in drawn} == {"svgf"}
    assert len({str(cell) for cell in drawn}) == 2
    assert len(select_cells(mixed, 99, Random(0))) == 2


def test_a_cell_measured_again_has_its_score(submitted, tmp_path):
    cells = submitted.submission.measured[::3]
    results = measure_again(submitted.submission, cells, submitted.clips, tmp_path / "again")
    assert [result.verdict for result in results] == [Verdict.PASSED] * 2
    assert results[0].found.endswith("+0.000 dB")


@pytest.mark.parametrize(("decibels", "verdict"), [(0.2, Verdict.FAILED), (-0.2, Verdict.WARNING)])
def test_a_cell_that_states_more_than_is_measured_fails(submitted, tmp_path, decibels, verdict):
    changed = shift(submitted.submission, decibels)
    cells = changed.measured[:1]
    (result,) = measure_again(changed, cells, submitted.clips, tmp_path / "again")
    assert result.verdict is verdict
    assert f"{-decibels:+.3f} dB" in result.found


def test_a_cell_without_its_clip_is_not_measured_again(submitted, tmp_path):
    cells = submitted.submission.measured[:1]
    (result,) = measure_again(submitted.submission, cells, {}, tmp_path / "again")
    assert result.verdict is Verdict.SKIPPED


def test_a_submission_without_scores_or_with_unknown_clips_agrees_with_nothing(submitted):
    for change in ({"cells": ()}, {"clips": ()}):
        changed = replace(submitted.submission, **change)
        result = check_against_scores(changed, str(submitted.results))
        assert (result.verdict is Verdict.SKIPPED) == ("cells" in change)
