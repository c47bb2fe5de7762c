import pytest
import torch

from rlbench.checks.result import Verdict
from rlbench.checks.stress import lying_buffers
from rlbench.checks.stress.lies import LIES, tell_lie
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from tests.checks.stress import broken_methods as broken


def results(method, quick=True):
    return {r.test: r for r in lying_buffers.run(broken.make_stressed_method(method), quick)}


def test_a_method_without_buffers_is_skipped():
    assert {result.verdict for result in results(broken.Mean()).values()} == {Verdict.SKIPPED}


@pytest.mark.parametrize(
    ("method", "test"),
    [
        (broken.CopiesAlbedo(), "albedo-noised"),
        (broken.MisusesAlbedo(), "albedo-dropped"),
        (broken.MisusesAlbedo(), "albedo-negated"),
        (broken.MisusesAlbedo(), "albedo-worth"),
    ],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_a_fault_is_found(method, test):
    found = results(method)
    assert found[test].verdict is Verdict.FAILED
    assert found[test].remedy
    assert found[test.replace("albedo", "depth")].verdict is Verdict.SKIPPED


def test_an_exception_fails_its_lie_alone():
    found = results(broken.RejectsBlackAlbedo())
    expected = results(broken.CopiesAlbedo())
    assert found["albedo-negated"].verdict is Verdict.FAILED
    assert "exception" in found["albedo-negated"].found
    assert found["albedo-noised"].figure == pytest.approx(expected["albedo-noised"].figure)


def test_a_method_that_trusts_motion_blindly_loses_by_wrong_motion():
    found = results(broken.TrustsMotion(), quick=False)
    assert found["motion-negated"].figure > 0.3


def test_a_buffer_that_is_read_and_ignored_costs_and_gains_nothing():
    found = results(broken.IgnoresAlbedo())
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
