"""Gates of speed: parsed, measured on real methods, and failed only beyond doubt."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from rlbench import registry
from rlbench.benchmark.latency import PartTime, Timing
from rlbench.benchmark.regression.comparison import (
    SpeedGate,
    judge,
    measure_gates,
    parse_gate,
)
from rlbench.errors import OptionError
from tests.conftest import write_plugin

ZERO = PartTime(0.0, 0.0, 0.0)
TIMING = Timing("clip", *(ZERO,) * 5, 30, 10, 0.0, 1.0, 1.0, 0.0, 0.0, 1)
GATE = SpeedGate("ours", "oidn", 1.3)


def timing(median, half_width=0.0, unreliable=""):
    inference = PartTime(median, median, median)
    return replace(TIMING, inference=inference, half_width=half_width, unreliable=unreliable)


@pytest.mark.parametrize(
    ("text", "gate"),
    [
        ("ours/latent/oidn<=1.3", SpeedGate("ours/latent", "oidn", 1.3)),
        ("mean/oidn/tuned <= 2", SpeedGate("mean", "oidn/tuned", 2.0)),
        (" oidn/tuned / oidn<=1e0", SpeedGate("oidn/tuned", "oidn", 1.0)),
        ("ours@bf16/ours<=0.8", SpeedGate("ours@bf16", "ours", 0.8)),
        ("ours@openvino-bf16/ours/latent<=1", SpeedGate("ours@openvino-bf16", "ours/latent", 1.0)),
    ],
)
def test_a_gate_names_two_rows_and_a_ratio(text, gate):
    assert parse_gate(text) == gate
    assert parse_gate(str(gate)) == gate


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ours/oidn", "is no gate. Write A/B<=1.3"),
        ("ours/oidn<=0", "is no gate"),
        ("ours/oidn<=nan", "is no gate"),
        ("ours/maen<=1", "no two installed methods"),
        ("ours<=1", "no two installed methods"),
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
        (timing(1.31), timing(1.0, 0.02), "not resolved"),
        (timing(1.29, 0.02), timing(1.0), "not resolved"),
        (timing(1.4, 0.02), timing(1.0, 0.02), "slower"),
        (timing(1.2, 0.02), timing(1.0, 0.02), "within"),
        (timing(9.0, unreliable="busy"), timing(1.0), "undecided"),
        (timing(1.0), timing(1.0, unreliable="busy"), "undecided"),
    ],
)
def test_a_gate_fails_only_where_the_whole_interval_exceeds_it(row, reference, verdict):
    result = judge(GATE, row, reference)
    assert result.verdict == verdict
    assert ("busy" in str(result)) == (verdict == "undecided")


def test_the_ends_of_the_interval_are_those_of_the_two_medians():
    result = judge(GATE, timing(3.0, 0.1), timing(2.0, 0.2))
    assert (result.low, result.ratio, result.high) == pytest.approx((2.7 / 2.4, 1.5, 3.3 / 1.6))


def test_two_rows_are_timed_once_each_and_judged():
    gates = [SpeedGate("eaw", "mean", 1e6), SpeedGate("mean", "eaw", 1e6)]
    done = []
    first, second = measure_gates(gates, torch.device("cpu"), 1, lambda: done.append(1))
    assert len(done) == 2
    if "undecided" not in (first.verdict, second.verdict):
        assert first.ratio * second.ratio == pytest.approx(1)
    assert {first.verdict, second.verdict} <= {"within", "undecided"}


def test_a_row_that_fails_is_an_error(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "broken.py", "broken", body="return 1 / 0, None"))
    with pytest.raises(OptionError, match="broken cannot be timed: ZeroDivisionError"):
        measure_gates([SpeedGate("broken", "mean", 1.0)], torch.device("cpu"), 1)
