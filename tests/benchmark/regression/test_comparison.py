"""The regression check fails when PSNR falls by more than is allowed, and says where."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import scipy.stats
import torch

from rlbench import registry
from rlbench.benchmark.latency import PartTime, Timing
from rlbench.benchmark.regression.baseline import (
    Baseline,
    BaselineEntry,
    BaselineError,
    Score,
    scores,
)
from rlbench.benchmark.regression.comparison import (
    SpeedGate,
    SpeedResult,
    compare,
    judge,
    measure_gates,
    parse_gate,
)
from rlbench.benchmark.results import to_dataframe
from rlbench.errors import OptionError
from tests.benchmark.regression.examples import baseline, rows
from tests.conftest import write_plugin


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
    assert compare(to_dataframe(rows(29.8)), baseline(tolerance_db=0.2)).has_passed  # its own


HALL = BaselineEntry("ours", "hall", 2.0, 30.0)

BOTH = replace(baseline(), entries=(*baseline().entries, HALL))

HOLE = replace(rows(30.0)[0], value=math.nan, note="out of memory")


@pytest.mark.parametrize(
    ("found", "expected", "subset", "verdict", "passed"),
    [
        (rows(30.0, scene="hall"), BOTH, False, "missing", False),
        (rows(30.0, scene="hall"), BOTH, True, "skipped", True),
        (rows(12.0, method="mean"), baseline(), True, "missing", False),  # no result of a method
        ([replace(row, value=math.inf) for row in rows(30.0)], baseline(), False, "missing", False),
        ([*rows(30.0), HOLE], baseline(), True, "missing", False),
        (rows(30.0) + rows(12.0, method="ntas"), baseline(), False, "same", True),
    ],
)
def test_a_missing_entry_fails_and_a_new_result_does_not(found, expected, subset, verdict, passed):
    report = compare(to_dataframe(found), expected, subset=subset)
    assert {diff.key: diff.verdict for diff in report.diffs}["ours", "city", 2.0] == verdict
    assert report.has_passed == passed


@pytest.mark.parametrize("entries", [baseline(), Baseline()])
def test_nothing_compared_is_not_passed(entries):
    report = compare(to_dataframe(rows(30.0)).iloc[:0], entries, subset=True)
    assert not report.has_passed
    assert "nothing was compared" in report.text()


OF_SEED_1 = rows(30.0) + rows(20.0, seed=1)

STANDARD = [replace(row, preset="standard") for row in rows(30.0)]

ON_A_GPU = [replace(row, device="a GPU") for row in rows(20.0)]

ON_A_CPU = [replace(row, device="a CPU") for row in rows(30.0)]


@pytest.mark.parametrize(
    ("found", "expected", "message"),
    [
        (STANDARD, baseline(), "of preset standard, the baseline of mini"),
        ([*rows(30.0), *STANDARD], baseline(), "2 presets"),
        (ON_A_CPU + ON_A_GPU, baseline(), "2 devices .a CPU, a GPU."),
        (OF_SEED_1, replace(baseline(), seed=2), "of seed 0, 1, the .* of seed 2.*--seed 2"),
        (rows(30.0), replace(baseline(), entries=baseline().entries * 2), "two entries"),
    ],
)
def test_results_that_cannot_be_compared_are_no_regression_and_no_success(found, expected, message):
    with pytest.raises(BaselineError, match=message):
        compare(to_dataframe(found), expected)


def test_other_seeds_of_the_results_do_not_count():
    assert compare(to_dataframe(OF_SEED_1), baseline()).text() == "passed: 1 same"


def test_the_mean_and_its_standard_error_are_over_frames_and_clips():
    more = [replace(row, clip="city-1", value=row.value + 4) for row in rows(30.0)]
    found = scores(to_dataframe(rows(30.0) + more), 0)
    values = [29.0, 31.0, 33.0, 35.0]
    error = round(scipy.stats.sem(values), 4)
    assert found == {("ours", "city", 2.0): Score(32.0, error, 4)}


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


def test_uncertain_times_are_named_and_gate_nothing():
    score = rows(30.0)
    time = replace(score[-1], metric="inference_ms", unit="ms", note="uncertain: busy")
    report = compare(to_dataframe([*score, time]), baseline())
    assert report.has_passed
    assert "uncertain times of ours, which gate nothing: city at 2 spp" in report.text()
    assert "uncertain" not in compare(to_dataframe(score), baseline()).text()


def timing(median, half_width=0.0, disturbance=""):
    parts, inference = (PartTime(0.0, 0.0, 0.0),) * 3, PartTime(median, median, median)
    numbers = (0.0, 0.0, "middle half", 30, 10, half_width, 1.0, 1.0, 0.0, 0.0, 1)
    found = Timing("clip", *parts, inference, parts[0], *numbers)
    return replace(found, disturbance=disturbance)


@pytest.mark.parametrize(
    ("text", "gate"),
    [
        ("ours/latent/oidn<=1.3", SpeedGate("ours/latent", "oidn", 1.3)),
        (" oidn/tuned / oidn<=1e0", SpeedGate("oidn/tuned", "oidn", 1.0)),
        ("ours@half/ours<=0.8", SpeedGate("ours@half", "ours", 0.8)),
        ("ours@openvino-half/ours/latent<=1", SpeedGate("ours@openvino-half", "ours/latent", 1.0)),
    ],
)
def test_a_gate_names_two_rows_and_a_ratio(text, gate):
    assert parse_gate(text) == gate
    assert parse_gate(str(gate)) == gate


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ours/oidn", "is not a bound. Write A/B<=1.3"),
        ("ours/oidn<=0", "is not a bound"),
        ("ours/maen<=1", "no two installed methods"),
        ("ours@seed1/ours<=1", "no two installed methods"),
        ("mean@tiles/mean<=1", "no two installed methods"),
    ],
)
def test_what_is_no_gate_is_refused(text, message):
    with pytest.raises(OptionError, match=message):
        parse_gate(text)


@pytest.mark.parametrize(
    ("row", "reference", "verdict"),
    [
        (timing(1.29), timing(1.0), "within"),
        (timing(1.31), timing(1.0), "slower"),
        (timing(1.31, 0.02), timing(1.0), "not resolved"),
        (timing(1.29, 0.02), timing(1.0), "not resolved"),
        (timing(1.4, 0.02), timing(1.0, 0.02), "slower"),
        (timing(1.2, 0.02), timing(1.0, 0.02), "within"),
        (timing(9.0, disturbance="busy"), timing(1.0), "undecided"),
        (timing(1.0), timing(1.0, disturbance="busy"), "undecided"),
    ],
)
def test_a_gate_fails_only_where_the_whole_interval_exceeds_it(row, reference, verdict):
    result = judge(SpeedGate("ours", "oidn", 1.3), row, reference)
    assert result.verdict == verdict
    assert ("busy" in str(result)) == (verdict == "undecided")


def test_the_ends_of_the_interval_are_those_of_the_two_medians():
    result = judge(SpeedGate("ours", "oidn", 1.3), timing(3.0, 0.1), timing(2.0, 0.2))
    assert (result.low, result.ratio, result.high) == pytest.approx((2.7 / 2.4, 1.5, 3.3 / 1.6))


def test_two_rows_are_timed_once_each_and_judged(tmp_path):
    gates = [SpeedGate("eaw", "mean", 1e6), SpeedGate("mean", "eaw", 1e6)]
    done = []
    first, second = measure_gates(gates, torch.device("cpu"), 1, lambda: done.append(1))
    assert len(done) == 2
    if "undecided" not in (first.verdict, second.verdict):
        assert first.ratio * second.ratio == pytest.approx(1)
    assert {first.verdict, second.verdict} <= {"within", "undecided"}
    registry.use_plugin(write_plugin(tmp_path / "broken.py", "broken", body="return 1 / 0, None"))
    with pytest.raises(OptionError, match="broken cannot be timed: ZeroDivisionError"):
        measure_gates([SpeedGate("broken", "mean", 1.0)], torch.device("cpu"), 1)
