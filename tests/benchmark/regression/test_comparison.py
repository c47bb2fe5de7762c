"""The regression check fails when PSNR falls by more than is allowed, and says where."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import pytest
import scipy.stats

from rlbench.benchmark.regression.baseline import (
    Baseline,
    BaselineEntry,
    BaselineError,
    Score,
    scores,
)
from rlbench.benchmark.regression.comparison import SpeedGate, SpeedResult, compare
from rlbench.benchmark.results import to_dataframe
from tests.benchmark.regression.examples import baseline, rows


def verdicts(report):
    return {diff.key: diff.verdict for diff in report.diffs}


@pytest.mark.parametrize(
    ("psnr", "verdict", "passed"),
    [
        (30.0, "same", True),
        (29.9901, "same", True),
        (29.99, "lower", True),
        (29.95, "lower", True),
        (29.9499, "worse", False),
        (30.05, "same", True),
        (30.0501, "better", True),
        (20.0, "worse", False),
    ],
)
def test_a_result_may_fall_by_the_tolerance_and_no_more(psnr, verdict, passed):
    report = compare(to_dataframe(rows(psnr)), baseline())
    assert (report.diffs[0].verdict, report.has_passed) == (verdict, passed)


def test_an_entry_may_have_a_tolerance_of_its_own():
    assert compare(to_dataframe(rows(29.8)), baseline(tolerance_db=0.2)).has_passed


def test_a_tolerance_of_zero_is_not_the_default():
    assert not compare(to_dataframe(rows(29.99)), baseline(tolerance_db=0.0)).has_passed


def test_a_missing_entry_fails():
    report = compare(to_dataframe(rows(30.0, scene="hall")), baseline())
    assert verdicts(report) == {("ours", "city", 2.0): "missing", ("ours", "hall", 2.0): "new"}
    assert not report.has_passed


def test_a_missing_entry_of_a_subset_is_skipped():
    table = to_dataframe(rows(30.0))
    written = replace(
        baseline(), entries=(*baseline().entries, BaselineEntry("ours", "hall", 2.0, 30.0))
    )
    report = compare(table, written, subset=True)
    assert verdicts(report)["ours", "hall", 2.0] == "skipped"
    assert report.has_passed


def test_a_method_without_any_result_is_missing_even_in_a_subset():
    report = compare(to_dataframe(rows(12.0, method="mean")), baseline(), subset=True)
    assert verdicts(report)["ours", "city", 2.0] == "missing"
    assert not report.has_passed


def test_results_without_entries_are_no_comparison():
    report = compare(to_dataframe(rows(30.0, scene="hall")), Baseline("mini"))
    assert "FAILED: nothing was compared, 1 new" in report.text()


def test_results_of_several_devices_are_not_averaged():
    other = [replace(row, device="a GPU", value=row.value + 9) for row in rows(20.0)]
    ours = [replace(row, device="a CPU") for row in rows(30.0)]
    with pytest.raises(BaselineError, match="2 devices .a CPU, a GPU."):
        compare(to_dataframe(ours + other), baseline())


@pytest.mark.parametrize("entries", [baseline(), Baseline()])
def test_nothing_compared_is_not_passed(entries):
    report = compare(to_dataframe(rows(30.0)).iloc[:0], entries, subset=True)
    assert not report.has_passed
    assert "nothing was compared" in report.text()


def test_a_result_without_value_is_missing_even_in_a_subset():
    hole = replace(rows(30.0)[0], value=math.nan, note="out of memory")
    report = compare(to_dataframe([*rows(30.0), hole]), baseline(), subset=True)
    assert not report.has_passed


def test_a_new_result_does_not_fail():
    table = to_dataframe(rows(30.0) + rows(12.0, method="ntas"))
    report = compare(table, baseline())
    assert verdicts(report)["ntas", "city", 2.0] == "new"
    assert report.has_passed


def test_the_text_says_what_fell_by_how_much_and_what_was_allowed():
    table = to_dataframe(rows(29.0) + rows(12.0, method="ntas"))
    text = compare(table, baseline(stderr_db=1.0)).text()
    worse = next(line for line in text.splitlines() if "WORSE" in line)
    assert worse.split() == [
        "WORSE",
        "ours",
        "city",
        "2",
        "30.000",
        "1.000",
        "29.000",
        "-1.000",
        "-0.050",
    ]
    assert text.splitlines()[-1] == "FAILED: 1 worse, 1 new"


def test_the_text_of_equal_results_is_one_line():
    assert compare(to_dataframe(rows(30.0)), baseline()).text() == "passed: 1 same"


def test_results_of_another_preset_are_no_regression_and_no_success():
    other = [replace(row, preset="standard") for row in rows(30.0)]
    with pytest.raises(BaselineError, match="of preset standard, the baseline of mini"):
        compare(to_dataframe(other), baseline())
    with pytest.raises(BaselineError, match="2 presets"):
        compare(to_dataframe([*rows(30.0), *other]), baseline())


def test_columns_of_the_text_line_up():
    table = to_dataframe(
        rows(29.0) + rows(9.0, method="a-much-longer/name", scene="temple", spp=0.25)
    )
    head, first, second, _ = compare(table, baseline()).text().splitlines()
    assert len(head) == len(first) == len(second)
    assert head.index("scene") == first.index("city") == second.index("temple")


def test_the_mean_and_its_standard_error_are_over_frames_and_clips():
    more = [replace(row, clip="city-1", value=row.value + 4) for row in rows(30.0)]
    found = scores(to_dataframe(rows(30.0) + more), 0)
    values = [29.0, 31.0, 33.0, 35.0]
    error = round(scipy.stats.sem(values), 4)
    assert found == {("ours", "city", 2.0): Score(32.0, error, 4)}


def test_other_seeds_of_the_results_do_not_count():
    table = to_dataframe(rows(30.0) + rows(20.0, seed=1))
    assert compare(table, baseline()).text() == "passed: 1 same"
    with pytest.raises(BaselineError, match="of seed 0, 1, the baseline is of seed 2.*--seed 2"):
        compare(table, replace(baseline(), seed=2))


def test_an_allowed_fall_is_shown_and_passes():
    report = compare(to_dataframe(rows(29.96)), baseline())
    assert report.has_passed
    assert report.text().splitlines()[1].startswith("lower")
    assert report.text().splitlines()[-1] == "passed: 1 lower"


def test_the_worst_change_is_the_largest_fall_in_decibels():
    table = to_dataframe(rows(29.96) + rows(25.0, scene="hall") + rows(40.0, scene="temple"))
    others = (BaselineEntry("ours", name, 2.0, 30.0) for name in ("hall", "temple"))
    report = compare(table, replace(baseline(), entries=(*baseline().entries, *others)))
    assert report.worst.key.scene == "hall"
    assert compare(to_dataframe(rows(31.0)), baseline()).worst is None


@pytest.mark.parametrize(
    ("verdict", "passed"),
    [("slower", False), ("within", True), ("not resolved", True), ("undecided", True)],
)
def test_only_a_speed_that_is_slower_beyond_doubt_fails(verdict, passed):
    result = SpeedResult(SpeedGate("ours", "oidn", 1.3), verdict, 1.5, 1.4, 1.6)
    report = replace(compare(to_dataframe(rows(30.0)), baseline()), speed=(result,))
    assert report.has_passed == passed
    assert f"speed {verdict}: ours / oidn <= 1.3, measured 1.500 [1.400, 1.600]" in report.text()
    assert f"1 same, speed {verdict}" in report.summary


def test_an_infinite_result_is_missing():
    table = to_dataframe(rows(30.0))
    report = compare(table.assign(value=math.inf), baseline())
    assert verdicts(report) == {("ours", "city", 2.0): "missing"}
    assert not report.has_passed


def test_an_entry_twice_is_refused():
    twice = replace(baseline(), entries=baseline().entries * 2)
    with pytest.raises(BaselineError, match="two entries"):
        compare(to_dataframe(rows(30.0)), twice)


def test_the_regression_check_does_not_import_torch():
    modules = "rlbench.cli.regress, rlbench.benchmark.regression.pages"
    look = f"import sys, {modules}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", look], check=False).returncode == 0


def test_unreliable_times_are_named_and_gate_nothing():
    score = rows(30.0)
    time = replace(score[-1], metric="inference_ms", unit="ms", note="unreliable: busy")
    report = compare(to_dataframe([*score, time]), baseline())
    assert report.has_passed
    assert "unreliable times of ours, which gate nothing: city at 2 spp" in report.text()
    assert "unreliable" not in compare(to_dataframe(score), baseline()).text()
