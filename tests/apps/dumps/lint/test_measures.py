"""The checks of a clip, against known answers: motion, noise, the reference, depth and normals."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from rlbench.apps.dumps.importers.jitter import halton_offset
from rlbench.apps.dumps.lint import radiance
from rlbench.apps.dumps.lint.checks import fit_depth, lint_clip
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, read_clip_arrays
from rlbench.apps.dumps.lint.geometry import VIEW_DEPTH, fit_rotation
from rlbench.apps.dumps.lint.jitter import find_jitter_fault, frame_disagreements
from rlbench.apps.dumps.lint.motion import FORMAT_V1, MotionConvention, check_motion
from rlbench.checks.result import Verdict
from tests.apps.dumps.lint.broken_fixtures import correct_clip, store


def cut_at(arrays: ClipArrays, index: int, outside: bool) -> ClipArrays:
    """The arrays with another clip from frame `index` on, as in the header."""
    other = correct_clip(7)

    def join(one: torch.Tensor, two: torch.Tensor) -> torch.Tensor:
        return torch.cat((one[:index], two[index:]))

    gbuffer = {k: join(v, other.gbuffer[k]) for k, v in arrays.gbuffer.items()}
    if outside:
        away = torch.tensor([-2.0 * arrays.header.width, -2.0 * arrays.header.height])
        gbuffer["motion"][index] = away.view(2, 1, 1)
    halves = join(arrays.half_a, other.half_a), join(arrays.half_b, other.half_b)
    pools = {"path": join(arrays.pools["path"], other.pools["path"])}
    return ClipArrays(replace(arrays.header, cuts=(index,)), gbuffer, pools, *halves)


@pytest.mark.parametrize("index", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_clip_whose_motion_points_outside_at_a_cut_passes(arrays, tmp_path, index):
    found = lint_clip(read_clip_arrays(store(cut_at(arrays, index, True), tmp_path / "cut")))
    assert {f.check: f.found for f in found if f.verdict is not Verdict.PASSED} == {}


def test_motion_into_another_shot_fails_and_an_undeclared_cut_is_a_warning(arrays):
    found = check_motion(cut_at(arrays, 2, False))
    assert found.verdict is Verdict.FAILED
    assert "frame 2 is a cut" in found.found
    secret = replace(cut_at(arrays, 2, True), header=arrays.header)
    assert check_motion(secret).verdict is Verdict.WARNING


def test_a_static_clip_needs_no_motion(arrays):
    still = {name: arrays.gbuffer[name][:1].repeat(4, 1, 1, 1) for name in ("albedo", "depth")}
    header = replace(arrays.header, static=True, buffers=tuple(still))
    found = check_motion(replace(arrays, header=header, gbuffer=still))
    assert found.verdict is Verdict.PASSED
    assert found.found == "static, and the G-buffer does not change"


def test_an_object_before_empty_background_is_compared_alone():
    """A disc that turns before empty background, as seen by an orbiting camera."""
    frames, h, w, turn, pan = 3, 64, 96, 0.1, 1.1  # pixels a frame: of the disc, and behind it
    y, x = torch.meshgrid(torch.arange(h) - 31.3, torch.arange(w) - 47.6, indexing="ij")
    disc = (x.square() + y.square() < 14**2).expand(frames, 1, h, w)
    at = torch.stack([x - turn * t for t in range(frames)])[:, None]
    waves = [torch.sin(a * at + b * y) for a, b in ((0.9, 0.4), (-0.5, 1.1), (0.3, -0.8))]
    texture = torch.cat(waves, 1)
    motion = torch.zeros(frames, 2, h, w)
    motion[:, :1] = torch.where(disc, -turn, pan)
    gbuffer = {
        "albedo": (texture * 0.4 + 0.5).where(disc, 0.0),
        "normal": torch.nn.functional.normalize(texture + 2, dim=1).where(disc, 0.0),
        "depth": torch.where(disc, 4.0, torch.inf),
        "motion": motion,
    }
    light = torch.zeros(frames, 3, h, w)
    header = replace(correct_clip(frames=1).header, frames=frames, reference_spp=(1,) * frames)
    found = check_motion(ClipArrays(header, gbuffer, {}, light, light))
    assert found.verdict is Verdict.PASSED, found.found


def test_a_convention_converts_stored_motion_to_pixels():
    stored = torch.tensor([0.5, -0.25]).view(1, 2, 1, 1).expand(1, 2, 10, 20)
    found = MotionConvention(True, (-1, 1), "NDC (-1..1)").to_pixels(stored)
    # y first: x is -0.25, of the other sign 0.25, times half of 20; y is 0.5 times half of 10
    torch.testing.assert_close(found[0, :, 0, 0], torch.tensor([2.5, 2.5]))
    torch.testing.assert_close(FORMAT_V1.to_pixels(stored), stored)


# Camera jitter


OFFSETS = torch.tensor([halton_offset(index) for index in range(4)])


def contain_jitter(arrays: ClipArrays, sign: int = 1) -> ClipArrays:
    """Motion plus the change of the jitter, as a jittered camera's matrices give it."""
    change = torch.cat([torch.zeros(1, 2), OFFSETS[1:] - OFFSETS[:-1]]).view(4, 2, 1, 1)
    motion = arrays.gbuffer["motion"] + sign * change
    return replace(arrays, gbuffer={**arrays.gbuffer, "motion": motion})


def declare_jitter(arrays: ClipArrays, *limitations: str) -> ClipArrays:
    offsets = tuple((float(x), float(y)) for x, y in OFFSETS)
    return replace(arrays, header=replace(arrays.header, jitter=offsets, limitations=limitations))


def test_the_disagreement_of_jittered_motion_is_the_change_of_the_jitter(arrays):
    found, spreads = frame_disagreements(contain_jitter(arrays), [1, 2, 3])
    # pixels; noise and interpolation between pixels, 0.12 at most on three clips
    torch.testing.assert_close(found, OFFSETS[:-1] - OFFSETS[1:], atol=0.15, rtol=0)
    assert float(spreads.max()) < 0.2


@pytest.mark.parametrize("is_declared", [False, True])
@pytest.mark.parametrize("contains", [False, True])
def test_motion_fails_where_it_contains_the_jitter(arrays, contains, is_declared):
    given = contain_jitter(arrays) if contains else arrays
    found = check_motion(declare_jitter(given) if is_declared else given)
    assert found.verdict is (Verdict.FAILED if contains else Verdict.PASSED), found.found
    assert ("motion seems to contain the jitter" in found.found) == contains


def test_a_jittered_reference_is_told_from_jittered_motion(arrays):
    # motion that lacks the change of the jitter, as where all images are moved by it
    moved = declare_jitter(contain_jitter(arrays, -1))
    assert "[reference] jittered = true" in check_motion(moved).found
    assert find_jitter_fault(declare_jitter(contain_jitter(arrays, -1), "reference jitter")) == ""
    # all images are moved, and motion with them
    assert "motion seems" in find_jitter_fault(declare_jitter(arrays, "reference jitter"))


def test_the_same_shift_in_all_frames_is_no_jitter(arrays):
    shifted = {**arrays.gbuffer, "motion": arrays.gbuffer["motion"] + 0.5}
    assert find_jitter_fault(replace(arrays, gbuffer=shifted)) == ""


# Noise


def test_independent_samples_correlate_by_one_over_the_others():
    generator = torch.Generator().manual_seed(0)
    pool = torch.randn(2, 8, 3, 64, 64, generator=generator).exp()
    noise = radiance.bounded_noise(pool)
    found, error = radiance.correlate(noise[:, 2], noise[:, 5])
    assert found == pytest.approx(-1 / 7, abs=4 * error)
    assert error < 0.02


def test_the_error_of_a_ratio_is_its_scatter_over_seeds():
    generator = torch.Generator().manual_seed(0)
    pairs = [torch.rand(2, 1, 3, 64, 64, generator=generator) for _ in range(60)]
    found = torch.tensor([radiance.ratio_of_sums(upper, lower) for upper, lower in pairs])
    # 60 draws give a standard deviation to within 1 / sqrt(120), 9 %; three times that
    assert float(found[:, 0].std() / found[:, 1].mean()) == pytest.approx(1, abs=0.28)


def test_an_unknown_reference_spp_predicts_no_noise(arrays):
    header = replace(arrays.header, reference_spp=(0,) * len(arrays))
    results = [
        check(replace(arrays, header=header))
        for check in (radiance.check_halves, radiance.check_noise_ceiling)
    ]
    assert all("reference_spp is not known" in result.found for result in results)


def test_the_noise_ceiling_is_the_psnr_of_noise_of_that_size():
    generator = torch.Generator().manual_seed(0)
    still = correct_clip(frames=1, half=1)
    shade = torch.full((1, 3, 72, 96), 0.25)
    noisy = [shade + 0.01 * torch.randn(shade.shape, generator=generator) for _ in "AB"]
    arrays = ClipArrays(replace(still.header, exposure=1.0), {}, {}, *noisy)
    slope = 1.055 / 2.4 * 0.25 ** (1 / 2.4 - 1)  # of the sRGB curve, by hand
    expected = -20 * math.log10(slope * 0.01 / math.sqrt(2))
    assert radiance.noise_ceiling_db(arrays) == pytest.approx(expected, abs=0.2)


def test_halves_that_share_half_of_their_noise_have_half_the_difference(arrays):
    own = radiance.half_noise_ratio(arrays)[0]
    noise = arrays.half_b - arrays.half_a
    # b' = a + noise / sqrt(2) differs from a by half the variance
    closer = replace(arrays, half_b=arrays.half_a + noise / math.sqrt(2))
    assert radiance.half_noise_ratio(closer)[0] == pytest.approx(
        own / 2, rel=0.1
    )  # weights move a little


# Geometry


def test_depth_and_normals_give_the_field_of_view_of_the_camera(arrays):
    fit = fit_depth(arrays)[VIEW_DEPTH]
    gbuffer = math.degrees(2 * math.atan(0.5 / fit.focal))
    assert gbuffer == pytest.approx(60, abs=3)  # the search's last step is 5 % of the focal length


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_rotation_is_fitted_despite_outliers(mirror):
    generator = torch.Generator().manual_seed(0)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    turn = turn * torch.linalg.det(turn) * mirror
    source = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator), dim=1)
    target = source @ turn.T
    target[:100] = target[:100].roll(1, 0)
    found = fit_rotation(source, target)[0]
    torch.testing.assert_close(found, turn, atol=0.01, rtol=0)  # a fifth lies
