import pytest
import torch

from rlbench.checks.result import Verdict
from rlbench.checks.stress import long_runs
from rlbench.checks.stress.long_clip import MOVING, STATIC, long_clip
from rlbench.checks.stress.state_size import largest_value, live_tensor_bytes, state_bytes
from tests.checks.stress import broken_methods as broken


def verdicts(method, quick=True):
    results = long_runs.run(broken.make_stressed_method(method), quick)
    return {result.test: result.verdict for result in results}


def test_a_method_that_accumulates_all_samples_passes_every_test():
    assert set(verdicts(broken.Accumulate()).values()) == {Verdict.PASSED}


def test_a_method_without_state_is_skipped():
    assert set(verdicts(broken.Mean()).values()) == {Verdict.SKIPPED}


@pytest.mark.parametrize(
    ("method", "tests"),
    [
        (broken.Drifts(), ["drift-static"]),
        (broken.NeverConverges(), ["convergence", "convergence-gap"]),
        (broken.GrowsState(), ["state-growth"]),
        (broken.GrowsMemory(), ["memory-growth"]),
        (broken.Overflows(), ["state-magnitude"]),
    ],
    ids=lambda value: "" if isinstance(value, list) else type(value).__name__,
)
def test_a_fault_is_found(method, tests):
    found = verdicts(method)
    assert Verdict.PASSED not in [found[test] for test in tests]


@pytest.mark.slow
def test_the_full_form_finds_drift_in_a_moving_clip_and_in_bf16():
    found = verdicts(broken.Drifts(), quick=False)
    drifts = [verdict for test, verdict in found.items() if test.startswith("drift")]
    assert len(drifts) == 4
    assert set(drifts) == {Verdict.FAILED}


def test_only_one_of_both_clips_moves_and_both_get_new_noise():
    first, second = long_clip(2, torch.device("cpu"))
    assert not first.gbuffer.motion[STATIC].any()
    assert first.gbuffer.motion[MOVING].any()
    assert torch.equal(first.reference.mean[STATIC], second.reference.mean[STATIC])
    assert not torch.equal(first.pool.radiance[STATIC], second.pool.radiance[STATIC])


def test_samples_of_the_static_clip_are_unbiased():
    frames = long_clip(200, torch.device("cpu"))
    mean = torch.stack([frame.pool.radiance[STATIC].mean(0) for frame in frames]).mean(0)
    ratio = mean.sum() / frames.frames[0].reference.mean[STATIC].sum()
    assert ratio == pytest.approx(1.0, abs=0.01)  # 400,000 samples: a standard error below 0.002


def test_state_bytes_count_tensors_and_other_values_at_any_depth():
    state = {"a": [torch.zeros(3)], "text": "x"}
    longer = {"a": [torch.zeros(3), torch.zeros(5)], "text": "x" * 101}
    assert state_bytes(longer) - state_bytes(state) >= 120


def test_the_largest_value_ignores_infinity_and_reports_nan():
    assert largest_value([torch.tensor([-7.0, torch.inf]), None]) == 7.0
    assert largest_value([torch.tensor([1.0, torch.nan])]) != largest_value([])


def test_live_tensor_bytes_see_a_tensor_until_it_is_freed():
    before = live_tensor_bytes()
    kept = torch.zeros(1000)
    view = kept[3:]
    assert live_tensor_bytes() - before == 4000
    del kept, view
    assert live_tensor_bytes() == before
