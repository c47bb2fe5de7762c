"""Each section passes a sound method, and finds the fault of each broken one."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from rlbench.checks.frame_edits import to_clip
from rlbench.checks.result import Verdict
from rlbench.checks.stress import long_runs, lying_buffers, precision, transformations
from rlbench.checks.stress.long_runs import (
    MOVING,
    STATIC,
    count_state_bytes,
    find_largest_value,
    long_clip,
)
from rlbench.checks.stress.lying_buffers import LIES, tell_lie
from rlbench.checks.stress.precision import convert_method
from rlbench.checks.stress.transformations import SYMMETRIES
from rlbench.checks.stress.wrappers import reverse_samples
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Samples, Size
from rlbench.ops.reprojection import reproject
from tests.checks.stress import broken_methods as broken
from tests.checks.stress.broken_methods import STATELESS, run_section, verdicts

CPU = torch.device("cpu")
SOUND = [
    (long_runs, broken.Accumulate(), {Verdict.PASSED, Verdict.SKIPPED}),
    (long_runs, broken.Mean(), {Verdict.PASSED, Verdict.SKIPPED}),
    (lying_buffers, broken.Mean(), {Verdict.SKIPPED}),
    (precision, broken.Mean(), {Verdict.PASSED, Verdict.SKIPPED}),
    (transformations, broken.Mean(), {Verdict.PASSED, Verdict.SKIPPED}),
]
FAULTS = [  # section, method, tests that find its fault
    (long_runs, broken.Drifts(), ["drift-static"]),
    (long_runs, broken.ForgetsToDeclare(), ["frame-alone", "drift-static"]),
    (long_runs, broken.RemembersOutside(), ["frame-alone"]),
    (long_runs, broken.NeverConverges(), ["convergence", "convergence-gap"]),
    (long_runs, broken.GrowsState(), ["state-growth"]),
    (long_runs, broken.GrowsMemory(), ["memory-growth"]),
    (long_runs, broken.Overflows(), ["state-magnitude"]),
    (lying_buffers, STATELESS["CopiesAlbedo"], ["albedo-noised"]),
    (
        lying_buffers,
        STATELESS["MisusesAlbedo"],
        ["albedo-dropped", "albedo-negated", "albedo-worth"],
    ),
    (precision, STATELESS["Cancels"], ["float32", "float32-worst-pixel"]),
    (precision, STATELESS["CancelsInHalf"], ["bf16", "bf16-worst-pixel"]),
    (precision, STATELESS["Unseeded"], ["rerun"]),
    (precision, STATELESS["DividesByBatch"], ["batch"]),
    (transformations, STATELESS["DependsOnExposure"], ["exposure-1e+04"]),
    (transformations, STATELESS["AddsLight"], ["exposure-1e-04", "black"]),
    (transformations, STATELESS["RejectsBlue"], ["channels-permuted"]),
    (transformations, STATELESS["PrefersRight"], ["flip-horizontal"]),
    (transformations, STATELESS["PrefersTop"], ["flip-vertical", "constant", "sky-only"]),
    (transformations, STATELESS["Tiles"], ["sub-tile-shift"]),
    (transformations, STATELESS["FirstSample"], ["sample-order"]),
    (transformations, broken.Accumulate(), ["flash", "flash-recovery", "teleport"]),
    (transformations, broken.TrustsMotion(), ["teleport-marked"]),
]


def label(value):
    return type(value).__name__ if isinstance(value, broken.Mean) else ""


@pytest.mark.parametrize(("section", "method", "expected"), SOUND, ids=label)
def test_a_sound_method_passes_every_test_that_applies_to_it(section, method, expected):
    assert set(verdicts(section, method).values()) == expected


@pytest.mark.parametrize(("section", "method", "tests"), FAULTS, ids=label)
def test_a_fault_is_found(section, method, tests):
    found = verdicts(section, method)
    assert Verdict.PASSED not in [found[test] for test in tests]
    if section in (lying_buffers, precision):
        assert {found[test] for test in tests} == {Verdict.FAILED}


@pytest.mark.slow
def test_the_full_form_finds_drift_in_a_moving_clip_and_in_bf16():
    found = verdicts(long_runs, broken.Drifts(), is_quick=False)
    drifts = [verdict for test, verdict in found.items() if test.startswith("drift")]
    assert drifts == [Verdict.FAILED] * 4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lost", "tests"), [(torch.nan, {"finite", "dip-moving"}), (0.0, {"dip-moving"})]
)
def test_the_full_form_finds_lost_frames_between_its_windows(monkeypatch, lost, tests):
    monkeypatch.setattr(long_runs, "FRAMES", 260)
    found = verdicts(long_runs, broken.LosesFrames(lost), is_quick=False)
    failed = {test for test, verdict in found.items() if verdict is Verdict.FAILED}
    assert tests <= failed <= tests | {f"{test}-bf16" for test in tests}


@pytest.mark.slow
def test_the_full_form_finds_a_dependence_on_threads():
    found = [verdicts(precision, m, False) for m in (STATELESS["DependsOnThreads"], broken.Mean())]
    assert [each["threads"] for each in found] == [Verdict.FAILED, Verdict.PASSED]


@pytest.mark.slow
def test_the_full_form_finds_a_history_that_is_trusted_for_long():
    found = verdicts(transformations, broken.Accumulate(), is_quick=False)
    assert found["flash-recovery"] is Verdict.FAILED
    assert found["teleport-recovery"] is Verdict.FAILED
    assert found["teleport-marked"] is Verdict.PASSED


# long runs


def test_only_one_of_both_clips_moves_and_both_get_new_noise():
    first, second = long_clip(2, CPU)
    assert not first.gbuffer.motion[STATIC].any()
    assert first.gbuffer.motion[MOVING].any()
    assert torch.equal(first.reference.mean[STATIC], second.reference.mean[STATIC])
    assert not torch.equal(first.pool.radiance[STATIC], second.pool.radiance[STATIC])


def test_samples_of_the_static_clip_are_unbiased():
    frames = long_clip(200, CPU)
    mean = torch.stack([frame.pool.radiance[STATIC].mean(0) for frame in frames]).mean(0)
    ratio = mean.sum() / frames.frames[0].reference.mean[STATIC].sum()
    assert ratio == pytest.approx(1.0, abs=0.01)  # 400,000 samples: a standard error below 0.002


def test_state_bytes_count_tensors_and_other_values_at_any_depth():
    state = {"a": [torch.zeros(3)], "text": "x"}
    longer = {"a": [torch.zeros(3), torch.zeros(5)], "text": "x" * 101}
    assert count_state_bytes(longer) - count_state_bytes(state) >= 120


def test_the_largest_value_ignores_infinity_and_reports_nan():
    assert find_largest_value([torch.tensor([-7.0, torch.inf]), None]) == 7.0
    assert find_largest_value([torch.tensor([1.0, torch.nan])]) != find_largest_value([])


# lying buffers


def test_an_exception_fails_its_lie_alone():
    found = run_section(lying_buffers, STATELESS["RejectsBlackAlbedo"])
    expected = run_section(lying_buffers, STATELESS["CopiesAlbedo"])
    assert found["albedo-negated"].verdict is Verdict.FAILED
    assert "exception" in found["albedo-negated"].found
    assert found["albedo-noised"].figure == pytest.approx(expected["albedo-noised"].figure)


def test_a_method_that_trusts_motion_blindly_loses_by_wrong_motion():
    found = run_section(lying_buffers, broken.TrustsMotion(), is_quick=False)
    assert found["motion-negated"].figure > 0.3


def test_a_buffer_that_is_read_and_ignored_costs_and_gains_nothing():
    found = run_section(lying_buffers, STATELESS["IgnoresAlbedo"])
    assert found["albedo-worth"].figure == 0.0
    assert found["albedo-dropped"].verdict is Verdict.PASSED


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("name", ["albedo", "normal", "depth", "motion"])
def test_a_lie_changes_one_buffer_in_a_later_frame_and_no_other(name, lie):
    frames = tuple(procedural_clip(seed=3, size=Size(1, 16, 24), frames=2))
    _, changed = tell_lie(frames, name, LIES[lie])
    right = frames[1].gbuffer.buffers
    for other, buffer in changed.gbuffer.buffers.items():
        assert torch.equal(buffer, right[other]) == (other != name)
    assert changed.gbuffer.buffers[name].shape == right[name].shape


@pytest.mark.parametrize("name", ["albedo", "normal", "depth", "motion"])
def test_noisy_buffers_are_legal(name):
    frames = tuple(procedural_clip(seed=3, size=Size(1, 16, 24), frames=1))
    (frame,) = tell_lie(frames, name, LIES["noised"])
    noisy = frame.gbuffer
    assert noisy.albedo.min() >= 0
    assert noisy.albedo.max() <= 1
    assert noisy.depth.min() >= 0
    lengths = noisy.normal.square().sum(1)
    assert bool(((lengths - 1).abs().lt(1e-5) | lengths.eq(0)).all())


# precision


def test_a_method_that_fails_in_float64_is_skipped_with_the_reason():
    before = torch.get_num_threads(), torch.get_default_dtype()
    results = run_section(precision, STATELESS["NeedsFloat32"])
    assert results["float32"].verdict is Verdict.SKIPPED
    assert "RuntimeError" in results["float32"].found
    assert "against float32" in results["bf16"].found
    assert (torch.get_num_threads(), torch.get_default_dtype()) == before


def test_a_converted_method_is_a_copy():
    method = broken.Mean(hidden={"parts": [nn.Linear(2, 2)], "scale": torch.ones(1)})
    converted = convert_method(method, torch.float64)
    for each, dtype in ((converted, torch.float64), (method, torch.float32)):
        assert each.hidden["parts"][0].weight.dtype == dtype
        assert each.hidden["scale"].dtype == dtype


# transformations


@pytest.mark.parametrize("name", SYMMETRIES)
def test_undoing_a_symmetry_gives_the_original_image(name):
    (frame,) = procedural_clip(seed=2, size=Size(1, 16, 24), frames=1)
    undone = SYMMETRIES[name].undo(SYMMETRIES[name].edit(frame).reference.mean)
    assert torch.allclose(undone, frame.reference.mean)


@pytest.mark.parametrize("name", ["flip-horizontal", "flip-vertical"])
def test_motion_of_a_flipped_clip_points_to_the_same_surface(name):
    flip = SYMMETRIES[name]
    before, now = to_clip(procedural_clip(seed=2, size=Size(1, 32, 48), frames=2))
    flipped_before, flipped_now = flip.edit(before), flip.edit(now)
    warped, valid = reproject(before.gbuffer.albedo, now.gbuffer.motion)
    flipped, _ = reproject(flipped_before.gbuffer.albedo, flipped_now.gbuffer.motion)
    inside = valid.expand_as(warped)
    assert torch.allclose(flip.undo(flipped)[inside], warped[inside], atol=1e-4)


def test_reversed_samples_are_the_drawn_ones_from_last_to_first():
    radiance = torch.arange(1.0, 5.0).view(1, 4, 1, 1, 1).expand(1, 4, 3, 1, 2)
    samples = Samples(radiance, torch.tensor([3, 0]).view(1, 1, 1, 2))
    drawn = Samples(radiance.where(samples.valid_mask, 0.0), samples.counts)
    assert reverse_samples(drawn).radiance[0, :, 0, 0].T.tolist() == [
        [3.0, 2.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 0.0],
    ]
