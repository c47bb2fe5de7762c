"""Motion of the sky: judged by closed forms and by the procedural world, computed from a camera."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from rlbench.apps.dumps.importers import formats, writer
from rlbench.apps.dumps.importers.conversions import OUTSIDE
from rlbench.apps.dumps.importers.layout import ready_layouts
from rlbench.apps.dumps.importers.sky import judge_sky, motion_at_infinity
from rlbench.apps.dumps.lint.checks import lint_clip
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, read_clip_arrays
from rlbench.checks.result import Verdict
from tests.apps.dumps.importers.dumps import FOV, camera_axes, write_blender
from tests.apps.dumps.lint.broken_fixtures import correct_clip, still_sky

H, W, FOCAL = 54, 72, 72 / 2 / np.tan(np.radians(30))


@pytest.fixture(scope="module")
def arrays() -> ClipArrays:
    return correct_clip(frames=3)


@pytest.fixture(scope="module")
def dump(arrays, tmp_path_factory) -> Path:
    """What Blender writes: no motion where nothing is hit."""
    folder = tmp_path_factory.mktemp("sky") / "dump"
    write_blender(still_sky(arrays), folder)
    columns = camera_axes(arrays).mT * torch.tensor([1, -1, -1])  # right, up and backward
    matrices = np.tile(np.eye(4), (len(arrays), 1, 1))
    matrices[:, :3, :3] = columns.numpy()
    (folder / "cameras.json").write_text(json.dumps(matrices.tolist()))
    return folder


def imported(dump: Path, out: Path, *keys: str, **options) -> ClipArrays:
    """The clip of a dump by Blender's layout with more keys in [motion]."""
    text = ready_layouts()["blender"].read_text()
    layout = out / "own.toml"
    layout.write_text("\n".join([text, *keys]))
    (sequence,) = formats.find_sequences(dump, str(layout), **options)
    writer.write_clip(sequence, writer.clip_header(sequence, None, 0.5), out / "clip")
    return read_clip_arrays(out / "clip", 0)


def test_a_sky_without_motion_is_unknown_and_listed(dump, arrays, tmp_path):
    found = imported(dump, tmp_path)
    assert found.header.limitations == ("sky motion",)
    sky = arrays.gbuffer["depth"].isinf()[:, 0]
    h, w = sky.shape[1:]
    motion = found.gbuffer["motion"].movedim(1, -1)
    assert (motion[sky] == torch.tensor([OUTSIDE * w, OUTSIDE * h])).all()
    expected = arrays.gbuffer["motion"].movedim(1, -1)[~sky]
    torch.testing.assert_close(motion[~sky], expected, rtol=0, atol=1e-4)  # pixels, in float32
    verdicts = {result.check: result.verdict for result in lint_clip(found)}
    assert verdicts["motion"] is verdicts["sky motion"] is Verdict.PASSED


def test_a_sky_moves_as_the_camera_turns_where_that_is_known(dump, arrays, tmp_path):
    found = imported(dump, tmp_path, 'camera = "cameras.json"', f"fov = {FOV}")
    assert found.header.limitations == ()
    # the first frame has no camera before it
    np.testing.assert_allclose(found.gbuffer["motion"][1:], arrays.gbuffer["motion"][1:], atol=1e-4)
    sky = arrays.gbuffer["depth"].isinf()[0, 0]
    assert (found.gbuffer["motion"][0, 0][sky] == OUTSIDE * sky.shape[1]).all()


def test_frames_have_the_cameras_of_their_numbers(dump, arrays, tmp_path):
    keys = ('camera = "cameras.json"', f"fov = {FOV}")
    found = imported(dump, tmp_path, *keys, frames=(2, 4))
    np.testing.assert_allclose(found.gbuffer["motion"][1], arrays.gbuffer["motion"][2], atol=1e-4)


def test_a_sky_that_is_declared_stored_stays(dump, arrays, tmp_path):
    found = imported(dump, tmp_path, 'sky = "stored"')
    sky = arrays.gbuffer["depth"].isinf()[:, 0]
    assert (found.gbuffer["motion"].movedim(1, -1)[sky] == 0).all()


def test_one_frame_of_many_with_a_still_sky_is_found(arrays, tmp_path):
    motion = arrays.gbuffer["motion"].clone()
    motion[1] = still_sky(arrays).gbuffer["motion"][1]
    write_blender(replace(arrays, gbuffer={**arrays.gbuffer, "motion": motion}), tmp_path / "dump")
    found = imported(tmp_path / "dump", tmp_path)
    assert found.header.limitations == ("sky motion",)
    np.testing.assert_allclose(found.gbuffer["motion"][0], arrays.gbuffer["motion"][0], atol=1e-4)


# The judgement, on scenes in closed form


def yaw(degrees: float) -> np.ndarray:
    """Axes to the right, down and forward as columns, turned about the vertical."""
    s, c = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def scene(turn: float, step: float, has_relief: bool = True) -> tuple[np.ndarray, ...]:
    """Motion, sky and depth of static surfaces below a sky without motion."""
    film = np.stack(np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5), -1)
    rays = np.concatenate([(film - [W / 2, H / 2]) / FOCAL, np.ones((H, W, 1))], -1)
    rng = np.random.default_rng(0)
    depth = 4 + (rng.random((H, W)) * 8 if has_relief else np.zeros((H, W)))
    points = (rays * depth[..., None]) @ yaw(turn).T + [step, 0, step / 2]
    motion = points[..., :2] / points[..., 2:] * FOCAL + [W / 2, H / 2] - film
    sky = np.arange(H)[:, None].repeat(W, 1) < H // 3
    return np.where(sky[..., None], 0, motion), sky, np.where(sky, np.inf, depth)[..., None]


@pytest.mark.parametrize(
    ("turn", "step", "surfaces", "judgement"),
    [
        (2, 0, "relief", "unwritten"),
        (2, 0.3, "relief", "unwritten"),
        (-10, 0.2, "relief", "unwritten"),
        (0, 0.3, "relief", "stored"),
        (0, -1.0, "relief", "stored"),
        (0, 0, "relief", "stored"),
        (2, 0, "a plane", "unclear"),
        (0, 0.3, "a plane", "unclear"),
        (2, 0, "no depth", "unclear"),
    ],
)
def test_a_still_sky_is_wrong_only_where_the_camera_turns(turn, step, surfaces, judgement):
    motion, sky, depth = scene(turn, step, surfaces != "a plane")
    assert judge_sky(motion, sky, None if surfaces == "no depth" else depth) == judgement


@pytest.mark.parametrize("turn", [0.5, -3, 40])
def test_points_at_infinity_move_by_a_rotation_alone(turn):
    found = motion_at_infinity(yaw(turn), yaw(0), 60, (H, W))
    angle = np.arctan((np.arange(W) + 0.5 - W / 2) / FOCAL) + np.radians(turn)
    expected = np.tan(angle) * FOCAL - (np.arange(W) + 0.5 - W / 2)
    np.testing.assert_allclose(found[H // 2, :, 0], expected, atol=1e-9)


def test_points_behind_the_previous_camera_point_outside():
    found = motion_at_infinity(yaw(180), yaw(0), 60, (H, W))
    assert (found == [OUTSIDE * W, OUTSIDE * H]).all()
