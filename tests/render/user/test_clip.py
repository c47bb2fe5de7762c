"""Scenes of one's own: Mitsuba XML and Python files, as clips."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from rlbench.benchmark import results
from rlbench.cli.app import app
from rlbench.clips.stored import open_clip, read_header, verify
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.render.presets import Preset
from rlbench.render.scene import SceneError
from rlbench.render.user import auto_exposure, camera_path
from rlbench.render.user.clip import UserSceneOptions, ensure_own
from rlbench.render.user.scene_file import open_scene_file
from tests.render.small_scenes import looking_down

H, W, FOV = 32, 48, 60.0
PLAN = Preset("test", "tests", (H, W), frames=3, reference_spp=2, pool_spp=2)
RADIUS = 0.8
BODY = f"""
<default name="max_depth" value="5"/>
<integrator type="path"><integer name="maxDepth" value="$max_depth"/></integrator>
<sensor type="perspective">
  <float name="fov" value="{FOV}"/>
  <transform name="toWorld">
    <lookat origin="0, 1.2, 4" target="0, 0.8, 0" up="0, 1, 0"/>
  </transform>
  <sampler type="sobol"><integer name="sampleCount" value="64"/></sampler>
  <film type="ldrfilm"><integer name="width" value="1200"/><integer name="height" value="800"/>
    <rfilter type="tent"/></film>
</sensor>
<bsdf type="twosided" id="Wood"><bsdf type="diffuse">
  <texture name="reflectance" type="bitmap">
    <string name="filename" value="textures/wood.png"/></texture></bsdf></bsdf>
<bsdf type="roughconductor" id="Gold">
  <string name="material" value="Au"/><float name="alpha" value="0.2"/></bsdf>
<shape type="rectangle" id="Floor">
  <transform name="toWorld"><rotate x="1" angle="-90"/><scale value="9"/></transform>
  <ref id="Wood"/></shape>
<shape type="sphere" id="Ball"><point name="center" x="0" y="{RADIUS}" z="0"/>
  <float name="radius" value="{RADIUS}"/><ref id="Gold"/></shape>
<shape type="cube"><transform name="toWorld"><scale value="0.3"/>
  <translate x="1.5" y="0.3" z="0.5"/></transform></shape>
<shape type="rectangle" id="Lamp">
  <transform name="toWorld"><rotate x="1" angle="90"/><translate y="4"/></transform>
  <emitter type="area"><rgb name="radiance" value="17, 12, 4"/></emitter></shape>
<shape type="obj" id="Flag"><string name="filename" value="flag.obj"/><ref id="Wood"/></shape>
"""
HOOK = """SCENE = "scene.xml"

def moving(time, rest):
    return {"Flag": rest["Flag"] + [0, 0.1 * time, 0]}
"""
PYTHON = """from dataclasses import replace
from tests.render.small_scenes import room

def scene():
    return room()
"""


def document(folder, body=BODY, version="0.6.0"):
    """A scene as Bitterli's are written: all files called scene.xml, textures beside, camelCase."""
    import mitsuba as mi

    (folder / "textures").mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(0).integers(50, 200, (8, 8, 3), np.uint8)
    mi.Bitmap(pixels).write(str(folder / "textures/wood.png"))
    (folder / "flag.obj").write_text("v 1 0 -1\nv 2 0 -1\nv 1.5 1 -1\nf 1 2 3\n")
    file = folder / "scene.xml"
    file.write_text(f'<scene version="{version}">{body}</scene>')
    return file


def look_at(origin, target):
    """Camera-to-world, written out again: columns left, up, forward, position."""
    forward = np.subtract(target, origin) / np.linalg.norm(np.subtract(target, origin))
    left = np.cross([0, 1, 0], forward) / np.linalg.norm(np.cross([0, 1, 0], forward))
    return np.vstack([np.stack([left, np.cross(forward, left), forward, origin], 1), [0, 0, 0, 1]])


def flown(folder, matrices, fov=FOV):
    file = folder / "path.json"
    file.write_text(json.dumps({"camera_to_world": np.array(matrices).tolist(), "fov": fov}))
    return str(file)


PASSING = [look_at([0.3 * i, 1.2 + 0.1 * i, 4 - 0.1 * i], [0, 0.8, 0]) for i in range(3)]


@pytest.fixture
def room(llvm, tmp_path, monkeypatch):
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path / "cache"))
    return document(tmp_path / "room")


def refused(wish, match):
    """`wish` is refused with words that match, and leaves nothing behind."""
    with pytest.raises(SceneError, match=match):
        ensure_own(wish, PLAN)
    folder = wish.out or wish.file.parent.parent / "cache" / "clips"
    assert not folder.exists()


def contents(folder):
    return {file.name: file.read_bytes() for file in sorted(folder.glob("*.exr"))}


def buffer(clip, name, index):
    return open_clip(clip).frame(index).gbuffer.buffers[name][0].permute(1, 2, 0).double().numpy()


def test_an_xml_scene_is_rendered_and_benchmarked_from_the_command_line(room, tmp_path):
    run = CliRunner()
    path = flown(room.parent, PASSING)
    words = ["--scene", room, "--camera", path, "--size", "24x16", "--preset", "tiny"]
    told = run.invoke(app, ["render", *map(str, words), "--out", str(tmp_path / "clip")])
    assert told.exit_code == 0, told.output
    assert verify(tmp_path / "clip") == []
    words = ["-m", "mean", "--clips", tmp_path / "clip", "--out", tmp_path / "results"]
    told = run.invoke(app, ["run", "--spp", "1", *map(str, words)])
    assert told.exit_code == 0, told.output
    rows = results.read(tmp_path / "results")
    assert np.isfinite(rows[rows["metric"] == "psnr"]["value"]).all()


def test_the_clip_says_what_it_shows(room):
    header = read_header(ensure_own(UserSceneOptions(room, flown(room.parent, PASSING[:2])), PLAN))
    assert (header.name, header.scene, header.frames) == ("room-path", "room", 2)
    assert (header.height, header.width) == (H, W)  # the film is 3 : 2, as the preset is
    assert header.licence == ""


def test_radiance_is_that_of_mitsuba_itself(room):
    import mitsuba as mi

    known = (
        BODY.replace("sobol", "independent").replace("ldrfilm", "hdrfilm").replace("tent", "box")
    )
    file = document(room.parent, known.replace('"1200"', f'"{W}"').replace('"800"', f'"{H}"'))
    truth = mi.TensorXf(mi.render(mi.load_file(str(file)), spp=256)).numpy()
    wish = UserSceneOptions(file, "still", exposure=1.0)
    clip = open_clip(ensure_own(wish, replace(PLAN, frames=1, reference_spp=128)))
    found = clip.frame(0).reference.half_a[0].permute(1, 2, 0).numpy()

    def areas(image):  # 8 x 8 pixels each
        return image.reshape(H // 8, 8, W // 8, 8, 3).mean((1, 3))

    # 8000 samples an area, each with a standard deviation of about twice its mean, of two images
    np.testing.assert_allclose(areas(found), areas(truth), rtol=0.15, atol=0.01)
    assert found.mean() == pytest.approx(truth.mean(), rel=0.02)


def world(matrix, film):
    """The first of floor and ball that is seen at film positions, in closed form, or far away.

    A ray's y reaches 0 at -oy / dy; |o + t d - c| = r is a quadratic equation in t.
    """
    slope = np.tan(np.radians(FOV / 2)) * 2 / W
    local = np.stack([(W / 2 - film[..., 0]) * slope, (H / 2 - film[..., 1]) * slope], -1)
    rays = np.concatenate([local, np.ones((H, W, 1))], -1) @ matrix[:3, :3].T
    origin = matrix[:3, 3]
    with np.errstate(invalid="ignore"):
        floor = np.where(rays[..., 1] < 0, -origin[1] / rays[..., 1], np.inf)
        along, away = (rays * (origin - [0, RADIUS, 0])).sum(-1), origin - [0, RADIUS, 0]
        square = (rays**2).sum(-1)
        root = np.sqrt(along**2 - square * (away @ away - RADIUS**2))
    floor, ball = np.minimum(floor, 1e6), np.nan_to_num((-along - root) / square, nan=1e6)
    return origin + np.minimum(floor, ball)[..., None] * rays


def test_motion_and_depth_are_those_of_a_closed_form(variant, tmp_path):
    room = document(tmp_path)
    plan = replace(PLAN, reference_spp=1, pool_spp=1)
    clip = ensure_own(
        UserSceneOptions(room, flown(room.parent, PASSING), out=tmp_path / "clip"), plan
    )
    centres = np.stack(np.meshgrid(np.arange(W), np.arange(H)), -1) + 0.5
    now, before = PASSING[2], PASSING[1]
    points = world(now, centres)
    local = (points - now[:3, 3]) @ now[:3, :3]
    seen = np.abs(local[..., 2] - buffer(clip, "depth", 2)[..., 0]) < 1e-3  # else cube, flag, lamp
    earlier = (points - before[:3, 3]) @ before[:3, :3]
    slope = np.tan(np.radians(FOV / 2)) * 2 / W
    there = np.array([W / 2, H / 2]) - earlier[..., :2] / earlier[..., 2:] / slope
    motion = buffer(clip, "motion", 2)
    assert seen.mean() > 0.4
    # points are float32: 1e-6 of metres, seen at 48 pixels a radian
    np.testing.assert_allclose(motion[seen], (there - centres)[seen], atol=1e-3)
    assert abs(motion[seen]).max() > 1


def test_the_sensor_of_the_file_is_the_middle_of_an_orbit(room):
    clip = ensure_own(UserSceneOptions(room), PLAN)
    middle = buffer(clip, "depth", 1)
    still = ensure_own(
        UserSceneOptions(room, flown(room.parent, [look_at([0, 1.2, 4], [0, 0.8, 0])])), PLAN
    )
    np.testing.assert_allclose(middle, buffer(still, "depth", 0), rtol=1e-4)


@pytest.mark.parametrize("camera", ["orbit", "dolly"])
def test_a_camera_made_from_the_scenes_own_moves(room, camera):
    clip = ensure_own(UserSceneOptions(room, camera), PLAN)
    # half a degree of 60, or 2 % of the way, on 48 pixels
    assert 0.1 < np.median(np.linalg.norm(buffer(clip, "motion", 1), axis=-1)) < 2


def test_a_still_camera_makes_a_static_clip(room):
    header = read_header(ensure_own(UserSceneOptions(room, "still"), PLAN))
    assert header.static
    assert "motion" not in header.buffers


def test_moved_vertices_have_their_motion_and_all_else_has_none(room):
    hook = room.with_name("waves.py")
    hook.write_text(HOOK)
    clip = ensure_own(UserSceneOptions(hook, "still"), PLAN)
    motion = buffer(clip, "motion", 2)
    depth = buffer(clip, "depth", 2)[..., 0]
    moved = np.abs(motion).max(-1) > 0
    # the flag stands 5 m away and rises 0.1 m a frame; the camera is tilted by 0.1 radian
    expected = 0.1 / 5 / (np.tan(np.radians(FOV / 2)) * 2 / W)
    assert 5 < moved.sum() < 100
    np.testing.assert_allclose(motion[moved][:, 1], expected, rtol=0.05)
    assert (np.abs(depth[moved] - 5) < 0.2).all()


@pytest.mark.slow  # instances take long to compile
def test_an_instance_is_seen_and_stands_still_beside_what_moves(room):
    shape = '<shape type="{}" id="Ball"><point name="center" x="0" y="0.8" z="0"/>'
    text = room.read_text().replace(
        shape.format("sphere"), '<shape type="instance"><ref id="Group"/></shape>'
        '<shape type="shapegroup" id="Group">' + shape.format("sphere")
    )  # fmt: skip
    text = text.replace('<ref id="Gold"/></shape>', '<ref id="Gold"/></shape></shape>')
    room.write_text(text)
    hook = room.with_name("waves.py")
    hook.write_text(HOOK)
    clip = ensure_own(UserSceneOptions(hook, "still"), PLAN)
    middle = slice(H // 2 - 3, H // 2 + 3), slice(W // 2 - 3, W // 2 + 3)
    assert (buffer(clip, "depth", 2)[middle] < 4 - RADIUS / 2).all()
    assert not buffer(clip, "motion", 2)[middle].any()


def test_no_kernel_is_compiled_after_the_first_frame_of_a_document(room):
    import drjit as dr

    hook = room.with_name("waves.py")
    hook.write_text(HOOK)
    path = camera_path.follow_matrices(PASSING)
    scene = replace(
        open_scene_file(hook).scene,
        camera=lambda time: camera_path.camera_from_matrix(path(time), FOV),
    )
    tracer = open_tracer(scene, H, W)

    def work(time):
        tracer.set_time(time)
        render_gbuffer(tracer)
        tracer.trace_images(2)

    work(0.0)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        work(1.0)
        work(2.0)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert kernels
    assert all(kernel["cache_hit"] for kernel in kernels)


def test_what_is_rendered_otherwise_than_asked_is_said(room):
    text = (
        room.read_text().replace('type="path"', 'type="volpath"').replace("maxDepth", "max_depth")
    )
    lens = '<float name="apertureRadius" value="0.1"/><float name="focusDistance" value="4"/>'
    room.write_text(text.replace('type="perspective">', f'type="thinlens">{lens}'))
    told = []
    ensure_own(UserSceneOptions(room, "still"), PLAN, told.append)
    assert "integrator volpath is replaced by path" in told
    assert any("everything is sharp" in words for words in told)


def test_a_python_scene_is_rendered_with_its_own_camera_and_exposure(room):
    file = room.with_name("mine.py")
    file.write_text(PYTHON)
    header = read_header(ensure_own(UserSceneOptions(file), PLAN))
    assert (header.name, header.exposure) == ("room-own", 2.0)


def test_defaults_of_the_file_can_be_replaced(room):
    def brightness(depth):
        wish = UserSceneOptions(room, "still", exposure=1.0, parameters=(("max_depth", depth),))
        return open_clip(ensure_own(wish, PLAN)).frame(0).reference.half_a.mean()

    assert brightness("2") < 0.95 * brightness("5")  # without light from the floor


def test_an_exposure_that_is_given_is_that_of_the_clip(room):
    assert (
        read_header(ensure_own(UserSceneOptions(room, "still", exposure=3.5), PLAN)).exposure == 3.5
    )


def test_the_exposure_makes_a_uniform_picture_grey(llvm):
    # an albedo of one half under a sky of 0.4 on all sides shows 0.2 everywhere
    material = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5] * 3}}
    tracer = open_tracer(looking_down(material, sky=0.4), 16, 16)
    assert auto_exposure.estimate_exposure(tracer, 1) == pytest.approx(
        0.18 / 0.2, rel=0.02
    )  # two digits, and noise


def test_what_is_there_is_not_rendered_again(room):
    clip = ensure_own(UserSceneOptions(room), PLAN)
    before = {file: file.stat().st_mtime_ns for file in clip.iterdir()}
    assert ensure_own(UserSceneOptions(room), PLAN) == clip
    assert {file: file.stat().st_mtime_ns for file in clip.iterdir()} == before


def test_the_same_scene_elsewhere_is_the_same_clip(room, tmp_path):
    again = ensure_own(
        UserSceneOptions(document(tmp_path / "b" / "room"), out=tmp_path / "again"), PLAN
    )
    assert contents(again) == contents(ensure_own(UserSceneOptions(room), PLAN))


def _paint(room):
    import mitsuba as mi

    mi.Bitmap(np.full((8, 8, 3), 90, np.uint8)).write(str(room.parent / "textures/wood.png"))


def _bend(room):
    (room.parent / "flag.obj").write_text("v 1 0 -1\nv 2 0 -1\nv 1.5 2 -1\nf 1 2 3\n")


def _dim(room):
    room.write_text(room.read_text().replace("17, 12, 4", "1, 12, 4"))


@pytest.mark.parametrize("change", [_paint, _bend, _dim], ids=["texture", "mesh", "XML"])
def test_a_changed_file_is_rendered_anew(room, change):
    clip = ensure_own(UserSceneOptions(room), PLAN)
    before = contents(clip)
    change(room)
    ensure_own(UserSceneOptions(room), PLAN)
    after = contents(clip)
    assert after.keys() == before.keys()
    assert after["referenceA.0001.exr"] != before["referenceA.0001.exr"]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("textures/wood.png", "textures/none.png", r"textures/none.png, of a bitmap at .*line \d"),
        ("flag.obj", "none.obj", "none.obj, of a obj at"),
        ("roughconductor", "unobtainium", 'Plugin "unobtainium" not found'),
        ("</bsdf></bsdf>", "</bsdf>", "failed: Start-end tags mismatch .line"),
        ("$max_depth", "$deepest", r"undefined parameter: \$deepest"),
        ('id="Gold">\n', 'id="Silver">\n', 'unresolved reference to "Gold"'),
        ('name="alpha"', 'name="alfa"', "unreferenced property"),
        ('type="perspective"', 'type="orthographic"', "orthographic is not supported.*pinhole"),
        ('id="Ball">', 'id="Ball"><medium name="interior" type="homogeneous"/>',
         "participating medium"),
        ("17, 12, 4", "0, 0, 0", "sees only black"),
        ('<rgb name="radiance" value="17, 12, 4"/>',
         '<texture type="mesh_attribute" name="radiance"><string name="name" value="face_light"/>'
         "</texture>", "radiance is a mesh attribute"),
        ('<rgb name="radiance" value="17, 12, 4"/>',
         '<spectrum type="blackbody" name="radiance"><float name="temperature" value="5000"/>'
         "</spectrum>", "cannot trace this scene with llvm_ad_rgb"),
    ],
)  # fmt: skip
def test_a_broken_file_is_refused(room, old, new, match):
    assert room.read_text().count(old) == 1
    room.write_text(room.read_text().replace(old, new))
    refused(UserSceneOptions(room), match)


def test_a_scene_without_lights_is_refused(room):
    dark = BODY.replace(
        '<emitter type="area"><rgb name="radiance" value="17, 12, 4"/></emitter>', ""
    )
    refused(UserSceneOptions(document(room.parent, dark)), "no light")


def test_a_parameter_that_the_file_does_not_have_is_refused(room):
    refused(UserSceneOptions(room, parameters=(("colour", "red"),)), "unused parameters")


def test_a_scene_without_a_sensor_needs_matrices(room):
    bare = BODY[: BODY.index("<sensor")] + BODY[BODY.index("</sensor>") + len("</sensor>") :]
    refused(UserSceneOptions(document(room.parent, bare)), "has no sensor.*JSON")
    clip = ensure_own(UserSceneOptions(room, flown(room.parent, PASSING)), PLAN)
    assert read_header(clip).frames == 3


INSIDE = look_at([1.5, 0.3, 0.5], [0, 0.3, 0])  # of the cube
AWAY = look_at([0, 1, 20], [0, 1, 40])


@pytest.mark.parametrize(
    ("matrices", "match"),
    [
        ([PASSING[0], INSIDE], r"frame 1: .*only black.*100% .*backs of surfaces.*inside a wall"),
        ([PASSING[0], PASSING[1], AWAY], r"frame 2: .*\(0, 1, 20\).*no surface; the scene spans"),
        ([2 * np.eye(4) - np.diag([0, 0, 0, 1])], "matrix 0 is not rigid.*lengths 2, 2, 2"),
        ([PASSING[0] + np.eye(4)[[1]].T * [[1, 0, 0, 0]]], "not rigid"),
        ([PASSING[0], np.diag([-1.0, 1, 1, 1])], "matrix 1 mirrors"),
        ([PASSING[0].T], "last row.*transposed"),
        ([np.eye(4) * np.nan], "four rows of four finite"),
        ([np.eye(3)], "four rows of four finite"),
        ([], "no list of matrices"),
    ],
)
def test_a_camera_path_that_cannot_be_is_refused(room, matrices, match):
    refused(UserSceneOptions(room, flown(room.parent, matrices)), match)


@pytest.mark.parametrize("fov", [0, 180, "wide"])
def test_a_field_of_view_that_cannot_be_is_refused(room, fov):
    refused(UserSceneOptions(room, flown(room.parent, PASSING, fov)), "between 0 and 180")


def test_a_camera_that_is_no_file_is_refused(room):
    refused(UserSceneOptions(room, "zoom"), "takes still, orbit, dolly, or a JSON")


def test_more_frames_than_matrices_are_refused(room):
    refused(UserSceneOptions(room, flown(room.parent, PASSING), frames=4), "has 3 matrices")


@pytest.mark.parametrize(
    ("code", "match"),
    [
        ("x = 1", "neither scene.*nor SCENE"),
        ("def scene():\n    return 3", "returned int, expected Scene"),
        ("def scene():\n    return 1 / 0", "line 2: ZeroDivisionError"),
        ("def scene(:", "SyntaxError"),
        (
            PYTHON.replace("room()", "looking_down({'type': 'unobtainium'})").replace(
                "import room", "import looking_down"
            ),
            "cannot trace.*unobtainium",
        ),
        (HOOK.replace('{"Flag"', '{"Pole"'), "moves 'Pole'; .*: Flag"),
        (HOOK.replace('{"Flag"', '{"Ball"'), "moves 'Ball'"),
        (HOOK.replace('rest["Flag"] +', ""), r"shape \[3\], expected finite.*\[3, 3\]"),
        (HOOK.replace("0.1", "float('nan')"), "expected finite"),
        (HOOK.replace("return {", "return time < 2 and {"), "returned bool"),
        (HOOK.replace("return {", "return {} if time > 1 else {"), "moves nothing, but at time 0"),
    ],
)
def test_a_python_file_that_cannot_be_used_is_refused(room, code, match):
    file = room.with_name("mine.py")
    file.write_text(code)
    refused(UserSceneOptions(file, "still"), match)


@pytest.mark.parametrize("name", ["none.xml", "textures/wood.png"])
def test_a_file_that_is_no_scene_is_refused(room, name):
    refused(UserSceneOptions(room.parent / name), "--scene takes")


def test_options_of_one_scene_without_one_are_refused(tmp_path):
    told = CliRunner().invoke(app, ["render", "--camera", "orbit"])
    assert told.exit_code == 2
    assert "belong to --scene" in told.output
