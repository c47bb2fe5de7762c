import pytest
import torch

from rlbench.checks.frame_edits import to_clip
from rlbench.checks.result import Verdict
from rlbench.checks.stress import transformations
from rlbench.checks.stress.sample_order import reverse_samples
from rlbench.checks.stress.symmetries import SYMMETRIES
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Samples, Size
from rlbench.ops.reprojection import reproject
from tests.checks.stress import broken_methods as broken


def verdicts(method, quick=True):
    results = transformations.run(broken.make_stressed_method(method), quick)
    return {result.test: result.verdict for result in results}


def test_the_mean_passes_every_test_that_applies_to_it():
    assert set(verdicts(broken.Mean()).values()) == {Verdict.PASSED, Verdict.SKIPPED}


@pytest.mark.parametrize(
    ("method", "test"),
    [
        (broken.DependsOnExposure(), "exposure-1e+04"),
        (broken.AddsLight(), "exposure-1e-04"),
        (broken.RejectsBlue(), "channels-permuted"),
        (broken.PrefersRight(), "flip-horizontal"),
        (broken.PrefersTop(), "flip-vertical"),
        (broken.Tiles(), "sub-tile-shift"),
        (broken.FirstSample(), "sample-order"),
        (broken.AddsLight(), "black"),
        (broken.PrefersTop(), "constant"),
        (broken.PrefersTop(), "sky-only"),
        (broken.Accumulate(), "flash"),
        (broken.Accumulate(), "flash-recovery"),
        (broken.Accumulate(), "teleport"),
        (broken.TrustsMotion(), "teleport-marked"),
    ],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_a_fault_is_found(method, test):
    assert verdicts(method)[test] is not Verdict.PASSED


@pytest.mark.slow
def test_the_full_form_finds_a_history_that_is_trusted_for_long():
    found = verdicts(broken.Accumulate(), quick=False)
    assert found["flash-recovery"] is Verdict.FAILED
    assert found["teleport-recovery"] is Verdict.FAILED
    assert found["teleport-marked"] is Verdict.PASSED


@pytest.mark.parametrize("name", SYMMETRIES)
def test_undoing_a_symmetry_gives_the_original_image(name):
    (frame,) = procedural_clip(seed=2, size=Size(1, 16, 24), frames=1)
    undone = SYMMETRIES[name].undo(SYMMETRIES[name].edit(frame).reference.mean)
    assert torch.allclose(undone, frame.reference.mean)


@pytest.mark.parametrize("name", ["flip-horizontal", "flip-vertical"])
def test_motion_of_a_flipped_clip_points_to_the_same_surface(name):
    flip = SYMMETRIES[name]
    clip = to_clip(procedural_clip(seed=2, size=Size(1, 32, 48), frames=2))
    before, now = clip
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
