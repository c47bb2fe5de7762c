"""A correct clip passes all checks, and each fault fails exactly its own check."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from rlbench.checks.lint.checks import fit_depth, lint_clip
from rlbench.checks.lint.clip_arrays import ClipArrays, read_clip_arrays
from rlbench.checks.lint.geometry import VIEW_DEPTH, fit_rotation
from rlbench.checks.lint.motion import check_motion
from rlbench.checks.lint.motion_conventions import FORMAT_V1, MotionConvention, all_conventions
from rlbench.checks.lint.noise_statistics import bounded_noise, correlate, ratio_of_sums
from rlbench.checks.lint.reference import (
    check_halves,
    check_noise_ceiling,
    half_noise_ratio,
    noise_ceiling_db,
)
from rlbench.checks.lint.values import check_finite
from rlbench.checks.result import Verdict
from rlbench.cli.app import app
from rlbench.clips.stored import ClipError, open_clip
from tests.checks.lint.broken_fixtures import FAULTS, break_values, correct_clip, store

QUICK = (  # one of each module runs always, all of them when slow tests do
    "y of motion points up",
    "depth is the distance to the camera",
    "normals are in camera space",
    "albedo is sRGB",
    "the G-buffer is upside down",
    "two samples share half of their pixels",
    "half A contains the pool",
    "the halves overlap",
)


def failed_checks(folder: Path) -> list[str]:
    return [f.check for f in lint_clip(read_clip_arrays(folder)) if f.verdict is Verdict.FAILED]


def test_a_correct_clip_passes_every_check(folder):
    found = lint_clip(read_clip_arrays(folder))
    assert {f.check: f.found for f in found if f.verdict is not Verdict.PASSED} == {}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_other_correct_clips_fail_no_check(tmp_path, seed):
    assert failed_checks(store(correct_clip(seed), tmp_path / "correct")) == []


@pytest.mark.parametrize(
    "fault",
    [f if f in QUICK else pytest.param(f, marks=pytest.mark.slow) for f in FAULTS],
)
def test_a_fault_fails_its_own_check_and_no_other(arrays, tmp_path, fault):
    check, break_clip = FAULTS[fault]
    assert failed_checks(store(break_clip(arrays), tmp_path / "faulty")) == [check]


def cut_at(arrays: ClipArrays, index: int, outside: bool) -> ClipArrays:
    """The arrays with another clip from frame `index` on, as in the header."""
    other, kept = correct_clip(7), slice(None, index)
    gbuffer = {k: torch.cat((v[kept], other.gbuffer[k][index:])) for k, v in arrays.gbuffer.items()}
    if outside:
        away = torch.tensor([-2.0 * arrays.header.width, -2.0 * arrays.header.height])
        gbuffer["motion"][index] = away.view(2, 1, 1)
    a, b = (torch.cat((one[kept], two[index:])) for one, two in _halves(arrays, other))
    pool = torch.cat((arrays.pools["path"][kept], other.pools["path"][index:]))
    return ClipArrays(replace(arrays.header, cuts=(index,)), gbuffer, {"path": pool}, a, b)


def _halves(one: ClipArrays, two: ClipArrays):
    return (one.half_a, two.half_a), (one.half_b, two.half_b)


@pytest.mark.parametrize("index", [1, 2])
def test_a_clip_whose_motion_points_outside_at_a_cut_passes(arrays, tmp_path, index):
    found = lint_clip(read_clip_arrays(store(cut_at(arrays, index, True), tmp_path / "cut")))
    assert {f.check: f.found for f in found if f.verdict is not Verdict.PASSED} == {}


def test_motion_that_points_into_another_shot_fails(arrays, tmp_path):
    faulty = store(cut_at(arrays, 2, False), tmp_path / "cut")
    (found,) = (f for f in lint_clip(read_clip_arrays(faulty)) if f.verdict is Verdict.FAILED)
    assert found.check == "motion"
    assert "frame 2 is a cut" in found.found


def test_an_undeclared_cut_is_a_warning(arrays, tmp_path):
    secret = cut_at(arrays, 2, True)
    secret = replace(secret, header=replace(secret.header, cuts=()))
    found = lint_clip(read_clip_arrays(store(secret, tmp_path / "cut")))
    assert [f.check for f in found if f.verdict is Verdict.WARNING] == ["motion"]


def test_a_nan_fails_one_check_which_reports_its_place(arrays, tmp_path):
    faulty = store(arrays, tmp_path / "faulty")
    break_values(faulty, arrays)
    found = [f for f in lint_clip(read_clip_arrays(faulty)) if f.verdict is Verdict.FAILED]
    assert [f.check for f in found] == ["finite values"]
    assert "2 in reference A; first: reference A frame 1 at x 5, y 3" in found[0].found


def test_a_failed_check_says_how_to_fix_it(arrays, tmp_path):
    faulty = store(FAULTS["motion is in NDC"][1](arrays), tmp_path / "faulty")
    (found,) = (f for f in lint_clip(read_clip_arrays(faulty)) if f.verdict is Verdict.FAILED)
    assert found.remedy == "convert it from (x, y) in NDC (-1..1), to the previous frame"


def test_infinite_depth_behind_glass_is_background_too(arrays):
    behind = arrays.gbuffer["depth"].clone()
    behind[0, 0, 3, 4] = torch.inf
    more = replace(arrays, gbuffer={**arrays.gbuffer, "depth_behind": behind})
    assert check_finite(more).verdict is Verdict.PASSED
    assert more.sanitized.gbuffer["depth_behind"][0, 0, 3, 4] == torch.inf


def test_an_unknown_reference_spp_predicts_no_noise(arrays):
    header = replace(arrays.header, reference_spp=(0,) * len(arrays))
    told = [check(replace(arrays, header=header)) for check in (check_halves, check_noise_ceiling)]
    assert all("reference_spp is not known" in finding.found for finding in told)


def test_a_static_clip_needs_no_motion(tmp_path):
    still = correct_clip(frames=1)
    frozen = {name: image.repeat(3, 1, 1, 1) for name, image in still.gbuffer.items()}
    header = replace(
        still.header, frames=3, static=True, reference_spp=still.header.reference_spp * 3,
        buffers=("albedo", "normal", "depth"),
    )  # fmt: skip
    many = correct_clip(frames=3)
    arrays = ClipArrays(
        header, {k: frozen[k] for k in header.buffers}, many.pools, many.half_a, many.half_b
    )
    (motion,) = (f for f in lint_clip(arrays) if f.check == "motion")
    assert (motion.verdict, motion.found) == (
        Verdict.PASSED,
        "static, and the G-buffer does not change",
    )


def test_arrays_equal_those_of_the_clip_reader(arrays, folder):
    frame = open_clip(folder, seed=3).frame(2)
    read = read_clip_arrays(folder)
    assert torch.equal(read.gbuffer["motion"][2, None], frame.gbuffer.motion)
    assert torch.equal(read.reference[2, None] * 0.5, frame.reference.mean)


def test_only_the_requested_frames_are_read(folder):
    assert len(read_clip_arrays(folder, 2)) == 2


def test_a_folder_that_is_no_clip_is_an_error(tmp_path):
    with pytest.raises(ClipError, match="no clip folder"):
        read_clip_arrays(tmp_path / "nowhere")


def test_conventions_are_every_combination_once():
    assert len(set(map(str, all_conventions()))) == len(all_conventions()) == 2 * 4 * 5 * 2


def test_a_convention_converts_stored_motion_to_pixels():
    stored = torch.tensor([0.5, -0.25]).view(1, 2, 1, 1).expand(1, 2, 10, 20)
    found = MotionConvention(True, (-1, 1), "NDC (-1..1)").to_pixels(stored)
    # y first: x is -0.25, of the other sign 0.25, times half of 20; y is 0.5 times half of 10
    torch.testing.assert_close(found[0, :, 0, 0], torch.tensor([2.5, 2.5]))
    torch.testing.assert_close(FORMAT_V1.to_pixels(stored), stored)


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
    torch.testing.assert_close(
        fit_rotation(source, target)[0], turn, atol=0.01, rtol=0
    )  # a fifth lies


def test_independent_samples_correlate_by_one_over_the_others():
    generator = torch.Generator().manual_seed(0)
    pool = torch.randn(2, 8, 3, 64, 64, generator=generator).exp()
    noise = bounded_noise(pool)
    found, error = correlate(noise[:, 2], noise[:, 5])
    assert found == pytest.approx(-1 / 7, abs=4 * error)
    assert error < 0.02


def test_the_error_of_a_ratio_is_its_scatter_over_seeds():
    generator = torch.Generator().manual_seed(0)
    pairs = [torch.rand(2, 1, 3, 64, 64, generator=generator) for _ in range(60)]
    found = torch.tensor([ratio_of_sums(upper, lower) for upper, lower in pairs])
    # 60 draws give a standard deviation to within 1 / sqrt(120), 9 %; three times that
    assert float(found[:, 0].std() / found[:, 1].mean()) == pytest.approx(1, abs=0.28)


def test_the_noise_ceiling_is_the_psnr_of_noise_of_that_size():
    generator = torch.Generator().manual_seed(0)
    still = correct_clip(frames=1, half=1)
    shade = torch.full((1, 3, 72, 96), 0.25)
    noisy = [shade + 0.01 * torch.randn(shade.shape, generator=generator) for _ in "AB"]
    arrays = ClipArrays(replace(still.header, exposure=1.0), {}, {}, *noisy)
    slope = 1.055 / 2.4 * 0.25 ** (1 / 2.4 - 1)  # of the sRGB curve, by hand
    expected = -20 * math.log10(slope * 0.01 / math.sqrt(2))
    assert noise_ceiling_db(arrays) == pytest.approx(expected, abs=0.2)


def test_halves_that_share_half_of_their_noise_have_half_the_difference(arrays):
    own = half_noise_ratio(arrays)[0]
    noise = arrays.half_b - arrays.half_a
    # b' = a + noise / sqrt(2) differs from a by half the variance
    closer = replace(arrays, half_b=arrays.half_a + noise / math.sqrt(2))
    assert half_noise_ratio(closer)[0] == pytest.approx(own / 2, rel=0.1)  # weights move a little


def test_the_command_passes_and_writes_a_figure(folder, tmp_path):
    words = ["lint", str(folder), "--picture", str(tmp_path / "seen.png"), "--frames", "3"]
    found = CliRunner().invoke(app, words)
    assert found.exit_code == 0, found.output
    assert "failed: 0" in found.output
    assert (tmp_path / "seen.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_fails_where_a_check_does(arrays, tmp_path):
    store(FAULTS["the halves are equal"][1](arrays), tmp_path / "clips" / "faulty")
    found = CliRunner().invoke(app, ["lint", str(tmp_path / "clips")])
    assert found.exit_code == 1, found.output
    assert "both halves are the same image" in found.output


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
