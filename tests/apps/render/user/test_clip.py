"""Clips of users' scenes: radiance, motion, exposure, and resuming."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.user import auto_exposure
from rlbench.apps.render.user.clip import UserSceneOptions, ensure_user_clip
from rlbench.benchmark import results
from rlbench.clips.header import read_header
from rlbench.clips.stored import open_clip, verify
from tests.apps.render.small_scenes import diffuse, looking_down
from tests.apps.render.user.xml_room import (
    BODY,
    FOV,
    PASSING,
    PRESET,
    RADIUS,
    H,
    W,
    buffer,
    contents,
    document,
    flown,
)
from tests.cli.runner import rlbench


def test_an_xml_scene_is_rendered_and_benchmarked_from_the_command_line(room, tmp_path):
    clip, path = tmp_path / "clip", flown(room.parent, PASSING)
    words = ("--camera", path, "--size", "24x16", "--preset", "tiny", "--out", clip)
    rlbench("render", room, *words)
    assert verify(clip) == []
    rlbench("run", "--spp", 1, "-m", "mean", "--clips", clip, "--out", tmp_path / "results")
    rows = results.read(tmp_path / "results")
    assert np.isfinite(rows[rows["metric"] == "psnr"]["value"]).all()


def test_the_header_describes_the_clip(room):
    path = flown(room.parent, PASSING[:2])
    clip = ensure_user_clip(UserSceneOptions(room, path, exposure=3.5), PRESET)
    header = read_header(clip)
    assert header.exposure == 3.5
    assert (header.name, header.scene, header.frames) == ("room-path", "room", 2)
    assert (header.height, header.width) == (H, W)  # the film is 3 : 2, as the preset is
    assert header.licence == ""


def test_radiance_equals_that_of_mitsubas_own_renderer(room):
    import mitsuba as mi

    body = BODY.replace("sobol", "independent").replace("ldrfilm", "hdrfilm").replace("tent", "box")
    file = document(room.parent, body.replace('"1200"', f'"{W}"').replace('"800"', f'"{H}"'))
    truth = mi.TensorXf(mi.render(mi.load_file(str(file)), spp=256)).numpy()
    options = UserSceneOptions(file, "still", exposure=1.0)
    clip = open_clip(ensure_user_clip(options, replace(PRESET, frames=1, reference_spp=128)))
    image = clip.frame(0).reference.half_a[0].permute(1, 2, 0).numpy()

    def areas(image):  # 8 x 8 pixels each
        return image.reshape(H // 8, 8, W // 8, 8, 3).mean((1, 3))

    # 8000 samples an area, each with a standard deviation of about twice its mean, of two images
    np.testing.assert_allclose(areas(image), areas(truth), rtol=0.15, atol=0.01)
    assert image.mean() == pytest.approx(truth.mean(), rel=0.02)


def world(matrix, film):
    """World positions of the floor or ball at film positions, in closed form; else far away.

    A ray's y reaches 0 at -oy / dy; |o + t d - c| = r is a quadratic equation in t.
    """
    slope = np.tan(np.radians(FOV / 2)) * 2 / W
    local = np.stack([(W / 2 - film[..., 0]) * slope, (H / 2 - film[..., 1]) * slope], -1)
    rays = np.concatenate([local, np.ones((H, W, 1))], -1) @ matrix[:3, :3].T
    origin = matrix[:3, 3]
    with np.errstate(invalid="ignore"):
        floor = np.where(rays[..., 1] < 0, -origin[1] / rays[..., 1], np.inf)
        along, offset = (rays * (origin - [0, RADIUS, 0])).sum(-1), origin - [0, RADIUS, 0]
        square = (rays**2).sum(-1)
        root = np.sqrt(along**2 - square * (offset @ offset - RADIUS**2))
    floor, ball = np.minimum(floor, 1e6), np.nan_to_num((-along - root) / square, nan=1e6)
    return origin + np.minimum(floor, ball)[..., None] * rays


def test_motion_and_depth_equal_a_closed_form(llvm, tmp_path):
    room = document(tmp_path)
    preset = replace(PRESET, reference_spp=1, pool_spp=1)
    clip = ensure_user_clip(
        UserSceneOptions(room, flown(room.parent, PASSING), out=tmp_path / "clip"), preset
    )
    centres = np.stack(np.meshgrid(np.arange(W), np.arange(H)), -1) + 0.5
    now, before = PASSING[2], PASSING[1]
    points = world(now, centres)
    local = (points - now[:3, 3]) @ now[:3, :3]
    # elsewhere the pixel shows cube, flag or lamp
    visible = np.abs(local[..., 2] - buffer(clip, "depth", 2)[..., 0]) < 1e-3
    earlier = (points - before[:3, 3]) @ before[:3, :3]
    slope = np.tan(np.radians(FOV / 2)) * 2 / W
    previous = np.array([W / 2, H / 2]) - earlier[..., :2] / earlier[..., 2:] / slope
    motion = buffer(clip, "motion", 2)
    assert visible.mean() > 0.4
    # points are float32: 1e-6 of metres, seen at 48 pixels a radian
    np.testing.assert_allclose(motion[visible], (previous - centres)[visible], atol=1e-3)
    assert abs(motion[visible]).max() > 1


def test_the_estimated_exposure_makes_a_uniform_image_grey(llvm):
    # an albedo of one half under a sky of 0.4 on all sides shows 0.2 everywhere
    tracer = open_tracer(looking_down(diffuse(0.5, 0.5, 0.5), sky=0.4), 16, 16)
    # two digits, and noise
    assert auto_exposure.estimate_exposure(tracer, 1) == pytest.approx(0.18 / 0.2, rel=0.02)


def test_differences_between_file_and_rendering_are_reported(room):
    text = room.read_text().replace('type="path"', 'type="volpath"')
    text = text.replace("maxDepth", "max_depth")
    lens = '<float name="apertureRadius" value="0.1"/><float name="focusDistance" value="4"/>'
    room.write_text(text.replace('type="perspective">', f'type="thinlens">{lens}'))
    messages = []
    ensure_user_clip(UserSceneOptions(room, "still"), replace(PRESET, frames=1), messages.append)
    assert "integrator volpath is replaced by path" in messages
    assert any("pinhole, without depth of field" in message for message in messages)


def test_a_finished_clip_is_not_rendered_again_and_another_folder_gives_the_same(room, tmp_path):
    clip = ensure_user_clip(UserSceneOptions(room), PRESET)
    before = {file: file.stat().st_mtime_ns for file in clip.iterdir()}
    messages = []
    assert ensure_user_clip(UserSceneOptions(room), PRESET, messages.append) == clip
    assert messages == []  # nor is it inspected
    assert {file: file.stat().st_mtime_ns for file in clip.iterdir()} == before
    moved = UserSceneOptions(document(tmp_path / "b" / "room"), out=tmp_path / "again")
    assert contents(ensure_user_clip(moved, PRESET)) == contents(clip)


BENT = b"v 1 0 -1\nv 2 0 -1\nv 1.5 2 -1\nf 1 2 3\n"
SCENE = f'<scene version="0.6.0">{BODY}</scene>'


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("textures/wood.png", b"P6 4 4 255 " + b"Z" * 48),  # grey: formats are known by content
        pytest.param("flag.obj", BENT, marks=pytest.mark.slow),
        ("scene.xml", SCENE.replace("17, 12, 4", "1, 12, 4").encode()),
    ],
)
def test_a_changed_file_is_rendered_again(room, name, content):
    clip = ensure_user_clip(UserSceneOptions(room), PRESET)
    before = contents(clip)
    (room.parent / name).write_bytes(content)
    ensure_user_clip(UserSceneOptions(room), PRESET)
    after = contents(clip)
    assert after.keys() == before.keys()
    assert after["referenceA.0001.exr"] != before["referenceA.0001.exr"]
