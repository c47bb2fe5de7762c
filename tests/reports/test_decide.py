"""The decision: answers computed by hand, break-evens in closed form, and what the text says."""

from __future__ import annotations

import json
import math
import re

import msgspec
import pandas as pd
import pytest

from reports.analysis.rows import ReportError
from reports.decide import GivenTimes, decide
from reports.decision_text import decision_text
from rlbench.benchmark.results import TWO_DEVICES
from tests.reports.formula_results import THREE, Formula, doubt, table


def test_the_best_of_three_methods_computed_by_hand():
    decision = decide(table(THREE), sample_ms=2.0, frame_ms=11.0)
    winner, runner_up = decision.candidates  # the slow one needs 12 + 2 ms
    assert (winner.method, winner.spp) == ("middle", pytest.approx(3.0))  # 5 + 3 x 2 ms
    assert winner.value.mean == pytest.approx(26 + math.log2(3))
    assert (winner.inference_ms, winner.sampling_ms) == (pytest.approx(5.0), pytest.approx(6.0))
    assert not winner.is_largest_budget
    assert (runner_up.method, runner_up.spp) == ("cheap", 4.0)  # 1 + 4 x 2 ms, all it has
    assert runner_up.is_largest_budget
    assert runner_up.difference.mean == pytest.approx(26 - (26 + math.log2(3)))


def test_break_evens_in_closed_form():
    decision = decide(table(THREE), sample_ms=2.0, frame_ms=11.0)
    found = {(c.changed, c.direction): (c.method, c.at_ms) for c in decision.changes}
    assert found["frame_ms", "lower"] == ("cheap", pytest.approx(7.0))  # 5 + 1 spp x 2 ms
    # the middle one has 28 dB at its largest budget; the slow one at 2 ** 0.5 spp
    assert found["frame_ms", "higher"] == ("slow", pytest.approx(12 + 2 * math.sqrt(2)))
    assert found["sample_ms", "lower"] == (None, None)  # the slow one never fits 11 ms
    assert found["sample_ms", "higher"] == ("cheap", pytest.approx(6.0))  # (11 - 5) / 1 spp
    alone = decide(table({"cheap": THREE["cheap"]}), sample_ms=2.0, frame_ms=11.0)
    nothing = next(c for c in alone.changes if (c.changed, c.direction) == ("sample_ms", "higher"))
    assert (nothing.method, nothing.at_ms) == (None, pytest.approx(10.0))


def test_the_interval_is_that_of_scenes_and_of_differences_between_them():
    methods = {"a": Formula(20.0, 1.0, 1.0, 0.5), "b": Formula(20.5, 1.0, 1.0, 0.0)}
    winner, runner_up = decide(table(methods), 1.0, 2.0).candidates
    half = 12.7062  # Student's t of two scenes, which differ by 1 dB: 0.5 x 2 / sqrt(2) / sqrt(2)
    assert winner.method == "b"
    assert runner_up.difference.low == pytest.approx(-0.5 - half * 0.5, rel=1e-4)
    assert runner_up.difference.high == pytest.approx(-0.5 + half * 0.5, rel=1e-4)
    assert runner_up.verdict == "not resolved"


def test_a_low_error_wins_where_low_is_better():
    rows = table(THREE).assign(direction="lower")
    decision = decide(rows, sample_ms=2.0, frame_ms=30.0)
    assert decision.candidates[0].method == "cheap"
    assert decision.candidates[0].spp == 1.0


SURE, TWO = table(THREE), pd.concat([table(THREE), table(THREE, device="H100")])


@pytest.mark.parametrize(
    ("rows", "frame_ms", "options", "words"),
    [
        (SURE, 2.5, {}, "times of CPU, 2 threads at 192x192.*cheap at 1 spp"),
        (SURE, 20.0, {"metric": "flip"}, "'flip' was requested.*metrics that do: psnr"),
        (SURE[SURE["unit"] != "ms"], 20.0, {}, "cheap has no time on every scene"),
        (TWO, 11.0, {}, "times of 2: CPU, 2 threads; H100. Name one"),
        (TWO, 11.0, {"device": "A100"}, "device 'A100' was requested"),
        (
            doubt(SURE, "slow"),
            11.0,
            {"strict": True},
            "--strict.* slow .*the machine was busy.*--times uncertain",
        ),
        (
            doubt(SURE, *THREE, low=0.1),
            2.5,
            {},
            r"cheap at 1 spp, needs 3 ms \(uncertain: 2.1 ms at least",
        ),
    ],
)
def test_a_question_without_an_answer_is_refused_with_what_there_is(rows, frame_ms, options, words):
    with pytest.raises(ReportError, match=words):
        decide(rows, 2.0, frame_ms, **options)


def test_times_are_those_of_the_named_device():
    assert decide(TWO, 2.0, 11.0, device="H100").inference_device == "H100"


def test_the_text_states_device_size_and_what_would_change_the_answer():
    text = decision_text(decide(table(THREE), 2.0, 11.0))
    assert text.startswith("middle at 3 spp: PSNR 27.58 dB [")
    assert "in 11 of 11 ms (0 G-buffer + 5 inference + 6 sampling)" in text
    assert "Runner-up: cheap at 4 spp: " in text
    assert "measured on CPU, 2 threads, at 192x192" in text
    assert "cheap wins where a sample costs above 6 ms" in text
    assert "slow wins where the deadline is above 14.8 ms" in text
    assert "Warning" not in text


def test_times_of_two_devices_are_said_in_the_first_line():
    rows = table(THREE)
    assert "Warning" not in decision_text(decide(rows, 2.0, 11.0))
    frame = rows.iloc[:1].assign(
        metric="frame_ms", note=f"{TWO_DEVICES} inference of CPU, samples of RTX 4090"
    )
    mixed = decision_text(decide(pd.concat([rows, frame]), 2.0, 11.0))
    assert "two devices: inference of CPU, samples of RTX 4090" in mixed.splitlines()[0]
    far = decision_text(decide(rows, 0.5, 11.0))
    assert "a sample takes 2 ms (path tracer, measured here)" in far.splitlines()[0]


def test_a_gbuffer_costs_as_many_samples_as_measured_or_what_is_given():
    rows = table({"a": Formula(20.0, 1.0, 5.0, gbuffer_ms=3.0)})  # 1.5 samples of 2 ms
    (scaled,) = decide(rows, 4.0, 100.0).candidates
    assert (scaled.gbuffer_ms, scaled.frame_ms) == (pytest.approx(6.0), pytest.approx(6 + 5 + 16))
    (given,) = decide(rows, 4.0, 100.0, gbuffer_ms=1.0).candidates
    assert (given.gbuffer_ms, given.frame_ms) == (pytest.approx(1.0), pytest.approx(1 + 5 + 16))


def test_raw_samples_never_win_and_are_named():
    methods = {"mean": Formula(30.0, 1.0, 0.0), "cheap": THREE["cheap"]}
    decision = decide(table(methods), 2.0, 11.0)
    assert [each.method for each in decision.candidates] == ["cheap"]
    assert decision.undenoised.value.mean == pytest.approx(32.0)
    assert "Without a denoiser, mean at 4 spp has 32.00 dB in 8 ms" in decision_text(decision)
    with pytest.raises(ReportError, match=r"no denoiser.*Without a denoiser, mean at 1.*as-cost"):
        decide(table(methods), 2.0, 2.5)


def test_times_of_a_cost_profile_replace_those_of_the_results():
    gpu = GivenTimes("RTX 4090", "1920x1080", "bench", 1.0, {"middle": 2.0, "slow": 9.0})
    decision = decide(table(THREE), 1.0, 6.0, given=gpu)
    (winner,) = decision.candidates
    assert (winner.method, winner.spp, winner.inference_ms) == ("middle", 4.0, pytest.approx(2.0))
    assert "cheap has no time in the cost profile" in decision.notes
    text = decision_text(decision)
    assert "measured on RTX 4090, at 1920x1080" in text
    assert "Warning" not in text


def test_notes_on_times_and_a_winner_at_its_largest_budget_are_passed_on():
    rows = table(THREE)
    is_time = (rows["metric"] == "plan_ms") & (rows["method"] == "slow")
    decision = decide(rows.assign(note=is_time.map({True: "odd", False: ""})), 0.1, 8.0)
    text = decision_text(decision, "rlbench run -m middle")
    assert "slow, plan_ms: odd" in text
    assert "4 spp is its largest measured budget" in text
    assert "Measure it: rlbench run -m middle\n" in text


def test_a_method_that_uncertain_times_could_make_the_winner_is_named():
    sure = decide(table(THREE), sample_ms=2.0, frame_ms=11.0)
    assert (sure.could_win, sure.uncertainty) == ((), 0.0)
    open_answer = decide(doubt(table(THREE), "slow", low=0.5), sample_ms=2.0, frame_ms=11.0)
    assert open_answer.candidates[0].method == sure.candidates[0].method == "middle"
    assert open_answer.could_win == ("slow",)  # 14 ms at 1 spp, or 8 ms
    text = decision_text(open_answer)
    assert re.search(r"Times here are uncertain by \d+ %: slow could take its place", text)
    assert "uncertain: inference_ms of slow on city, hall at 1, 2, 4 spp: the machine" in text


def test_uncertain_times_that_change_no_answer_leave_it_alone():
    rows = doubt(table(THREE), "cheap", low=0.2, high=3.0)
    decision = decide(rows, sample_ms=2.0, frame_ms=11.0, strict=True)
    assert decision.could_win == ()
    assert "could take its place" not in decision_text(decision)
    assert re.search(r"cheap +4 +9 ±22 %", decision_text(decision))  # 1 + 8 ms, or 3 + 8


def test_the_uncertain_time_of_a_clips_sample_does_not_matter_to_a_given_one():
    rows = table(THREE)
    ends = [
        rows[rows["metric"] == "sampling_ms"].assign(metric=f"sampling_{end}_ms", value=value)
        for end, value in (("low", 0.1), ("high", 900.0))
    ]
    answer = decide(pd.concat([rows, *ends], ignore_index=True), sample_ms=2.0, frame_ms=11.0)
    assert (answer.could_win, answer.notes) == ((), ())
    assert repr(answer) == repr(decide(rows, sample_ms=2.0, frame_ms=11.0))  # nan differs from nan


def test_equal_results_give_equal_decisions_that_json_can_hold(results):
    first, second = (decide(results, 10.0, 50.0) for _ in range(2))
    assert msgspec.json.encode(first) == msgspec.json.encode(second)
    loaded = json.loads(msgspec.json.encode(first))
    assert loaded["candidates"][0]["difference"]["low"] is None
    assert loaded["candidates"][0]["method"] == "ours"
