"""The regression check: it fails when PSNR falls, says where, and its baseline is rewritten."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace

import pytest

from rlbench.benchmark.baseline import (
    Baseline,
    BaselineEntry,
    BaselineError,
    load_baseline,
    write_baseline,
)
from rlbench.benchmark.regression import compare, mean_psnr, update_baseline
from rlbench.benchmark.results import Row, to_dataframe


def rows(psnr, method="ours", scene="city", spp=2.0):
    """Two frames whose mean is `psnr`, and a row of another metric that must not count."""
    row = Row("r", method, f"{scene}-0", scene, spp, spp, 0, "psnr", psnr - 1, preset="mini")
    other = replace(row, frame=-1, metric="relmse", value=99.0)
    return [row, replace(row, frame=1, value=psnr + 1), other]


def baseline(psnr=30.0, **entry):
    return Baseline(
        "mini", "rlbench run", 0.05, (BaselineEntry("ours", "city", 2.0, psnr, **entry),)
    )


def verdicts(report):
    return {diff.key: diff.verdict for diff in report.diffs}


@pytest.mark.parametrize(
    ("psnr", "verdict", "passed"),
    [
        (30.0, "same", True),
        (29.95, "same", True),
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


def test_an_entry_is_not_dropped_from_a_baseline_because_its_method_crashed(tmp_path):
    update_baseline(to_dataframe(rows(30.0)), tmp_path / "b.json")
    crashed = replace(rows(0.0)[0], frame=-1, value=math.nan, note="RuntimeError: ...")
    with pytest.raises(BaselineError, match="no PSNR of ours on city at 2 spp"):
        update_baseline(to_dataframe([crashed, *rows(12.0, method="mean")]), tmp_path / "b.json")


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
    text = compare(table, baseline()).text()
    worse = next(line for line in text.splitlines() if "WORSE" in line)
    assert worse.split() == ["WORSE", "ours", "city", "2", "30.000", "29.000", "-1.000", "-0.050"]
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


def test_the_mean_is_over_frames_and_clips():
    more = [replace(row, clip="city-1", value=row.value + 4) for row in rows(30.0)]
    assert mean_psnr(to_dataframe(rows(30.0) + more)) == {("ours", "city", 2.0): 32.0}


def test_a_rewritten_baseline_equals_its_results(tmp_path):
    table = to_dataframe(rows(30.123456) + rows(12.0, method="ntas"))
    written = update_baseline(table, tmp_path / "b.json")
    assert load_baseline(tmp_path / "b.json") == written
    assert compare(table, written).text() == "passed: 2 same"


def test_a_rewritten_baseline_keeps_tolerances_and_command(tmp_path):
    path = tmp_path / "b.json"
    update_baseline(to_dataframe(rows(30.0)), path)
    content = json.loads(path.read_text())
    content["command"] = "rlbench run"
    content["tolerance_db"] = 0.1
    content["entries"][0]["tolerance_db"] = 0.3
    path.write_text(json.dumps(content))
    entry = BaselineEntry("ours", "city", 2.0, 31.0, 0.3)
    assert update_baseline(to_dataframe(rows(31.0)), path) == Baseline(
        "mini", "rlbench run", 0.1, (entry,)
    )


def test_an_unsupported_budget_is_left_out_of_a_rewritten_baseline(tmp_path):
    skipped = replace(rows(0.0, spp=0.5)[0], frame=-1, value=math.nan, note="supports 1 to 8 spp")
    table = to_dataframe([*rows(31.0), skipped])
    written = update_baseline(table, tmp_path / "b.json")
    assert [entry.target_spp for entry in written.entries] == [2.0]
    assert compare(table, written).has_passed


def test_the_file_has_one_line_an_entry(tmp_path):
    update_baseline(to_dataframe(rows(30.0) + rows(12.0, method="ntas")), tmp_path / "b.json")
    lines = (tmp_path / "b.json").read_text().splitlines()
    assert sum('"method"' in line for line in lines) == 2


def test_a_result_without_value_cannot_be_a_baseline(tmp_path):
    hole = replace(rows(30.0)[0], value=math.nan, note="out of memory")
    with pytest.raises(BaselineError, match="no PSNR of ours on city at 2 spp"):
        update_baseline(to_dataframe([hole]), tmp_path / "b.json")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "is not JSON"),
        ("[]", "has schema list, expected 1 or 2"),
        ('{"schema": 7}', "has schema 7, expected 1 or 2"),
        ('{"schema": 1}', "missing, unknown or wrong field"),
        (
            '{"schema": 1, "preset": "", "command": "", "tolerance_db": 1, "entries": [{"a": 1}]}',
            "keys a",
        ),
    ],
)
def test_a_broken_baseline_says_what_is_wrong(tmp_path, content, message):
    (tmp_path / "b.json").write_text(content)
    with pytest.raises(BaselineError, match=message):
        load_baseline(tmp_path / "b.json")


NUMBERS = {"tolerance_db": 0.05, "target_spp": 2.0, "psnr": 30.0}
ENTRY = {"method": "ours", "scene": "city", "target_spp": 2.0, "psnr": 30.0}


def document(**changed: object) -> dict[str, object]:
    head = {"schema": 2, "preset": "mini", "command": "", "tolerance_db": 0.05, "entries": [ENTRY]}
    return {**head, **changed}


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
@pytest.mark.parametrize("field", NUMBERS)
def test_a_baseline_with_a_number_that_is_not_finite_is_refused(tmp_path, field, number):
    text = json.dumps(document()).replace(f'"{field}": {NUMBERS[field]}', f'"{field}": {number}')
    assert number in text
    (tmp_path / "b.json").write_text(text)
    with pytest.raises(BaselineError, match="--baseline|--update"):
        load_baseline(tmp_path / "b.json")


@pytest.mark.parametrize("number", [math.nan, math.inf, -0.1])
def test_the_gate_has_no_tolerance_that_every_score_passes(number):
    with pytest.raises(BaselineError, match="tolerance_db is .*; a finite number >= 0 is required"):
        replace(baseline(), tolerance_db=number)
    with pytest.raises(BaselineError, match="tolerance_db is .*; a finite number >= 0 is required"):
        baseline(tolerance_db=number)


@pytest.mark.parametrize("psnr", [math.nan, math.inf, -math.inf])
def test_the_gate_has_no_expected_score_that_every_score_passes(psnr):
    with pytest.raises(BaselineError, match="ours on city at 2 spp has psnr"):
        baseline(psnr)


def test_an_infinite_result_is_missing():
    table = to_dataframe(rows(30.0))
    report = compare(table.assign(value=math.inf), baseline())
    assert verdicts(report) == {("ours", "city", 2.0): "missing"}
    assert not report.has_passed


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"entries": ["x"]}, r"Expected `object`, got `str` - at `\$.entries\[0\]`"),
        ({"entries": [None]}, r"Expected `object`, got `null`"),
        ({"entries": {"a": 1}}, "Expected `array`, got `object`"),
        ({"entries": [{**ENTRY, "psnr": "30"}]}, r"Expected `float`.*entries\[0\].psnr"),
        ({"entries": [{**ENTRY, "method": 3}]}, r"Expected `str`.*entries\[0\].method"),
        ({"entries": [{**ENTRY, "target_spp": -1}]}, "target_spp is -1"),
        ({"preset": 3}, "Expected `str`, got `int`.*preset"),
        ({"tolerance_db": None}, "Expected `float`, got `null`.*tolerance_db"),
        ({"tolerance_db": -1}, "tolerance_db is -1"),
        ({"colour": 1}, "unknown keys colour"),
    ],
)
def test_a_baseline_of_wrong_types_says_which_field_and_what_to_do(tmp_path, changed, message):
    (tmp_path / "b.json").write_text(json.dumps(document(**changed)))
    with pytest.raises(BaselineError, match=f"{message}.*rlbench regress --update"):
        load_baseline(tmp_path / "b.json")


@pytest.mark.parametrize("content", [b"\xff", b'{"schema": 2, "preset": "\xe9"}', b"[" * 100_000])
def test_a_baseline_that_is_not_json_in_utf_8_is_refused(tmp_path, content):
    (tmp_path / "b.json").write_bytes(content)
    with pytest.raises(BaselineError, match="is not JSON.*Restore the file, or pass another"):
        load_baseline(tmp_path / "b.json")


def test_a_baseline_of_schema_1_is_read_under_todays_names(tmp_path):
    old = {"method": "ours/A2@half", "scene": "city", "spp": 2.0, "psnr": 30.0}
    content = {"schema": 1, "preset": "mini", "command": "", "tolerance_db": 0.1, "entries": [old]}
    (tmp_path / "b.json").write_text(json.dumps(content))
    read = load_baseline(tmp_path / "b.json")
    assert read.entries == (BaselineEntry("ours/A2@bf16", "city", 2.0, 30.0),)
    write_baseline(read, tmp_path / "b.json")
    assert json.loads((tmp_path / "b.json").read_text())["entries"] == [
        {"method": "ours/A2@bf16", "scene": "city", "target_spp": 2.0, "psnr": 30.0}
    ]
    assert load_baseline(tmp_path / "b.json") == read


def test_a_baseline_that_is_not_there_says_how_to_make_it(tmp_path):
    with pytest.raises(BaselineError, match="--update makes one"):
        load_baseline(tmp_path / "b.json")


def test_an_entry_twice_is_refused():
    twice = replace(baseline(), entries=baseline().entries * 2)
    with pytest.raises(BaselineError, match="two entries"):
        compare(to_dataframe(rows(30.0)), twice)


def test_the_regression_check_does_not_import_torch():
    look = "import sys, rlbench.benchmark.regression; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", look], check=False).returncode == 0


def test_unreliable_times_are_named_and_gate_nothing():
    score = rows(30.0)
    time = replace(score[-1], metric="inference_ms", unit="ms", note="unreliable: busy")
    report = compare(to_dataframe([*score, time]), baseline())
    assert report.has_passed
    assert "unreliable times of ours, which gate nothing: city at 2 spp" in report.text()
    assert "unreliable" not in compare(to_dataframe(score), baseline()).text()
