"""A clean clip is all green, and each planted fault turns exactly its own check red."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from rlbench.checks.finding import Verdict
from rlbench.checks.lint.checks import examine, geometry
from rlbench.checks.lint.clip_arrays import ClipArrays, read_footage
from rlbench.checks.lint.geometry import VIEW, rotation
from rlbench.checks.lint.motion import motion as check_motion
from rlbench.checks.lint.motion_conventions import STORED, MotionConvention, readings
from rlbench.checks.lint.noise_statistics import bounded, correlation, ratio
from rlbench.checks.lint.reference import ceiling, ceiling_db, half_noise, halves
from rlbench.checks.lint.values import finite
from rlbench.cli.app import app
from rlbench.clips.stored import ClipError, open_clip
from tests.checks.lint.broken_fixtures import FAULTS, break_values, clean, store

QUICK = (  # one of each module runs always, all of them when slow tests do
    "y of motion points up",
    "depth is the distance to the eye",
    "normals are in camera space",
    "albedo is sRGB",
    "the view is upside down",
    "two samples are half the same",
    "the pool is in half A",
    "the halves overlap",
)


@pytest.fixture(scope="module")
def footage() -> ClipArrays:
    return clean()


@pytest.fixture(scope="module")
def folder(footage, tmp_path_factory) -> Path:
    return store(footage, tmp_path_factory.mktemp("lint") / "clean")


def red(folder: Path) -> list[str]:
    return [f.check for f in examine(read_footage(folder)) if f.verdict is Verdict.FAIL]


def test_a_clean_clip_is_all_green(folder):
    found = examine(read_footage(folder))
    assert {f.check: f.found for f in found if f.verdict is not Verdict.PASS} == {}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_other_clean_clips_have_no_red(tmp_path, seed):
    assert red(store(clean(seed), tmp_path / "clean")) == []


@pytest.mark.parametrize(
    "fault",
    [f if f in QUICK else pytest.param(f, marks=pytest.mark.slow) for f in FAULTS],
)
def test_a_fault_turns_its_own_check_red_and_no_other(footage, tmp_path, fault):
    check, plant = FAULTS[fault]
    assert red(store(plant(footage), tmp_path / "faulty")) == [check]


def cut_at(footage: ClipArrays, index: int, outside: bool) -> ClipArrays:
    """The footage, in which another clip is shown from frame `index` on, as its header says."""
    other, kept = clean(7), slice(None, index)
    gbuffer = {
        k: torch.cat((v[kept], other.gbuffer[k][index:])) for k, v in footage.gbuffer.items()
    }
    if outside:
        away = torch.tensor([-2.0 * footage.header.width, -2.0 * footage.header.height])
        gbuffer["motion"][index] = away.view(2, 1, 1)
    a, b = (torch.cat((one[kept], two[index:])) for one, two in _halves(footage, other))
    pool = torch.cat((footage.pools["path"][kept], other.pools["path"][index:]))
    return ClipArrays(replace(footage.header, cuts=(index,)), gbuffer, {"path": pool}, a, b)


def _halves(one: ClipArrays, two: ClipArrays):
    return (one.half_a, two.half_a), (one.half_b, two.half_b)


@pytest.mark.parametrize("index", [1, 2])
def test_a_clip_with_a_cut_at_which_all_comes_from_outside_is_green(footage, tmp_path, index):
    found = examine(read_footage(store(cut_at(footage, index, True), tmp_path / "cut")))
    assert {f.check: f.found for f in found if f.verdict is not Verdict.PASS} == {}


def test_motion_that_leads_into_another_shot_is_red(footage, tmp_path):
    faulty = store(cut_at(footage, 2, False), tmp_path / "cut")
    (found,) = (f for f in examine(read_footage(faulty)) if f.verdict is Verdict.FAIL)
    assert found.check == "motion"
    assert "frame 2 is a cut" in found.found


def test_a_cut_that_is_not_told_is_odd(footage, tmp_path):
    secret = cut_at(footage, 2, True)
    secret = replace(secret, header=replace(secret.header, cuts=()))
    found = examine(read_footage(store(secret, tmp_path / "cut")))
    assert [f.check for f in found if f.verdict is Verdict.WARN] == ["motion"]


def test_one_broken_value_is_red_in_one_check_and_told_with_its_place(footage, tmp_path):
    faulty = store(footage, tmp_path / "faulty")
    break_values(faulty, footage)
    found = [f for f in examine(read_footage(faulty)) if f.verdict is Verdict.FAIL]
    assert [f.check for f in found] == ["finite"]
    assert "2 in reference A; first: reference A frame 1 at x 5, y 3" in found[0].found


def test_what_fails_says_what_would_do(footage, tmp_path):
    faulty = store(FAULTS["motion is in NDC"][1](footage), tmp_path / "faulty")
    (found,) = (f for f in examine(read_footage(faulty)) if f.verdict is Verdict.FAIL)
    assert found.remedy == "convert it from (x, y) in NDC (-1..1), to the previous frame"


def test_nothing_behind_a_pane_is_background_too(footage):
    behind = footage.gbuffer["depth"].clone()
    behind[0, 0, 3, 4] = torch.inf
    more = replace(footage, gbuffer={**footage.gbuffer, "depth_psr": behind})
    assert finite(more).verdict is Verdict.PASS
    assert more.sound.gbuffer["depth_psr"][0, 0, 3, 4] == torch.inf


def test_a_number_of_samples_that_is_not_known_predicts_nothing(footage):
    header = replace(footage.header, reference_spp=(0,) * len(footage))
    told = [check(replace(footage, header=header)) for check in (halves, ceiling)]
    assert all("reference_spp is not known" in finding.found for finding in told)


def test_a_static_clip_needs_no_motion(tmp_path):
    still = clean(frames=1)
    frozen = {name: image.repeat(3, 1, 1, 1) for name, image in still.gbuffer.items()}
    header = replace(
        still.header, frames=3, static=True, reference_spp=still.header.reference_spp * 3,
        buffers=("albedo", "normal", "depth"),
    )  # fmt: skip
    many = clean(frames=3)
    footage = ClipArrays(
        header, {k: frozen[k] for k in header.buffers}, many.pools, many.half_a, many.half_b
    )
    (motion,) = (f for f in examine(footage) if f.check == "motion")
    assert (motion.verdict, motion.found) == (Verdict.PASS, "static, and the view does not change")


def test_footage_holds_what_the_clip_reader_reads(footage, folder):
    frame = open_clip(folder, seed=3).frame(2)
    read = read_footage(folder)
    assert torch.equal(read.gbuffer["motion"][2, None], frame.gbuffer.motion)
    assert torch.equal(read.reference[2, None] * 0.5, frame.reference.mean)


def test_only_the_frames_asked_for_are_read(folder):
    assert len(read_footage(folder, 2)) == 2


def test_a_folder_that_is_no_clip_is_told(tmp_path):
    with pytest.raises(ClipError, match="no clip folder"):
        read_footage(tmp_path / "nowhere")


def test_readings_are_every_combination_once():
    assert len(set(map(str, readings()))) == len(readings()) == 2 * 4 * 5 * 2


def test_a_reading_turns_stored_motion_into_pixels():
    stored = torch.tensor([0.5, -0.25]).view(1, 2, 1, 1).expand(1, 2, 10, 20)
    found = MotionConvention(True, (-1, 1), "NDC (-1..1)").pixels(stored)
    # y first: x is -0.25, of the other sign 0.25, times half of 20; y is 0.5 times half of 10
    torch.testing.assert_close(found[0, :, 0, 0], torch.tensor([2.5, 2.5]))
    torch.testing.assert_close(STORED.pixels(stored), stored)


def test_depth_and_normals_give_the_field_of_view_of_the_camera(footage):
    fit = geometry(footage)[VIEW]
    gbuffer = math.degrees(2 * math.atan(0.5 / fit.focal))
    assert gbuffer == pytest.approx(60, abs=3)  # the search's last step is 5 % of the focal length


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_rotation_is_found_among_outliers(mirror):
    draw = torch.Generator().manual_seed(0)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=draw))[0]
    turn = turn * torch.linalg.det(turn) * mirror
    source = torch.nn.functional.normalize(torch.randn(500, 3, generator=draw), dim=1)
    target = source @ turn.T
    target[:100] = target[:100].roll(1, 0)
    torch.testing.assert_close(rotation(source, target)[0], turn, atol=0.01, rtol=0)  # a fifth lies


def test_independent_samples_correlate_by_one_over_the_others():
    draw = torch.Generator().manual_seed(0)
    pool = torch.randn(2, 8, 3, 64, 64, generator=draw).exp()
    share = bounded(pool)
    found, error = correlation(share[:, 2], share[:, 5])
    assert found == pytest.approx(-1 / 7, abs=4 * error)
    assert error < 0.02


def test_the_error_of_a_ratio_is_its_scatter_over_seeds():
    draw = torch.Generator().manual_seed(0)
    pairs = [torch.rand(2, 1, 3, 64, 64, generator=draw) for _ in range(60)]
    found = torch.tensor([ratio(upper, lower) for upper, lower in pairs])
    # 60 draws give a standard deviation to within 1 / sqrt(120), 9 %; three times that
    assert float(found[:, 0].std() / found[:, 1].mean()) == pytest.approx(1, abs=0.28)


def test_the_ceiling_is_the_psnr_of_noise_of_that_size():
    draw = torch.Generator().manual_seed(0)
    still = clean(frames=1, half=1)
    shade = torch.full((1, 3, 72, 96), 0.25)
    noisy = [shade + 0.01 * torch.randn(shade.shape, generator=draw) for _ in "AB"]
    footage = ClipArrays(replace(still.header, exposure=1.0), {}, {}, *noisy)
    slope = 1.055 / 2.4 * 0.25 ** (1 / 2.4 - 1)  # of the sRGB curve, by hand
    expected = -20 * math.log10(slope * 0.01 / math.sqrt(2))
    assert ceiling_db(footage) == pytest.approx(expected, abs=0.2)


def test_halves_that_share_half_of_their_noise_have_half_the_difference(footage):
    own = half_noise(footage)[0]
    noise = footage.b - footage.a
    # b' = a + noise / sqrt(2) differs from a by half the variance
    closer = replace(footage, b=footage.a + noise / math.sqrt(2))
    assert half_noise(closer)[0] == pytest.approx(own / 2, rel=0.1)  # weights move a little


def test_the_command_is_green_and_writes_a_picture(folder, tmp_path):
    words = ["lint", str(folder), "--picture", str(tmp_path / "seen.png"), "--frames", "3"]
    found = CliRunner().invoke(app, words)
    assert found.exit_code == 0, found.output
    assert "0 FAIL" in found.output
    assert (tmp_path / "seen.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_fails_where_a_check_does(footage, tmp_path):
    store(FAULTS["the halves are one image"][1](footage), tmp_path / "clips" / "faulty")
    found = CliRunner().invoke(app, ["lint", str(tmp_path / "clips")])
    assert found.exit_code == 1, found.output
    assert "both halves are the same image" in found.output


def test_an_object_before_nothing_is_judged_by_itself():
    """A disc that turns before a void, as an orbit around it shows it: what is behind moves on."""
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
    header = replace(clean(frames=1).header, frames=frames, reference_spp=(1,) * frames)
    found = check_motion(ClipArrays(header, gbuffer, {}, light, light))
    assert found.verdict is Verdict.PASS, found.found
