"""Users' scene files: Mitsuba XML and Python."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.user import camera_path
from rlbench.apps.render.user.clip import UserSceneOptions, ensure_user_clip
from rlbench.apps.render.user.scene_file import open_scene_file
from rlbench.clips.header import read_header
from rlbench.clips.stored import open_clip
from tests.apps.render.conftest import check_no_kernel_is_compiled
from tests.apps.render.user.xml_room import (
    BODY,
    FOV,
    HOOK,
    PASSING,
    PRESET,
    RADIUS,
    H,
    W,
    buffer,
    check_refused,
    document,
    flown,
)

LAMP = '<emitter type="area"><rgb name="radiance" value="17, 12, 4"/></emitter>'
PYTHON = """from tests.apps.render.small_scenes import looking_down, room

def scene():
    return room()
"""


def write_hook(room):
    hook = room.with_name("waves.py")
    hook.write_text(HOOK)
    return hook


def test_moved_vertices_have_motion_and_nothing_else_has(room):
    hook = write_hook(room)
    clip = ensure_user_clip(UserSceneOptions(hook, "still"), PRESET)
    motion = buffer(clip, "motion", 2)
    depth = buffer(clip, "depth", 2)[..., 0]
    moved = np.abs(motion).max(-1) > 0
    # the flag stands 5 m away and rises 0.1 m a frame; the camera is tilted by 0.1 radian
    expected = 0.1 / 5 / (np.tan(np.radians(FOV / 2)) * 2 / W)
    assert 5 < moved.sum() < 100
    np.testing.assert_allclose(motion[moved][:, 1], expected, rtol=0.05)
    assert (np.abs(depth[moved] - 5) < 0.2).all()


@pytest.mark.slow  # instances take long to compile
def test_an_instance_is_visible_and_static_beside_moving_meshes(room):
    shape = '<shape type="{}" id="Ball"><point name="center" x="0" y="0.8" z="0"/>'
    text = room.read_text().replace(
        shape.format("sphere"), '<shape type="instance"><ref id="Group"/></shape>'
        '<shape type="shapegroup" id="Group">' + shape.format("sphere")
    )  # fmt: skip
    text = text.replace('<ref id="Gold"/></shape>', '<ref id="Gold"/></shape></shape>')
    room.write_text(text)
    hook = write_hook(room)
    clip = ensure_user_clip(UserSceneOptions(hook, "still"), PRESET)
    middle = slice(H // 2 - 3, H // 2 + 3), slice(W // 2 - 3, W // 2 + 3)
    assert (buffer(clip, "depth", 2)[middle] < 4 - RADIUS / 2).all()
    assert not buffer(clip, "motion", 2)[middle].any()


def test_no_kernel_is_compiled_after_the_first_frame_of_an_xml_scene(room):
    hook = write_hook(room)
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
    check_no_kernel_is_compiled(lambda: [work(1.0), work(2.0)])


def test_a_python_scene_is_rendered_with_its_own_camera_and_exposure(room):
    file = room.with_name("mine.py")
    file.write_text(PYTHON)
    header = read_header(ensure_user_clip(UserSceneOptions(file), PRESET))
    assert (header.name, header.exposure) == ("room-own", 2.0)


def test_default_values_of_the_file_can_be_replaced(room):
    def brightness(depth):
        options = UserSceneOptions(room, "still", exposure=1.0, parameters=(("max_depth", depth),))
        return open_clip(ensure_user_clip(options, PRESET)).frame(0).reference.half_a.mean()

    assert brightness("2") < 0.95 * brightness("5")  # without light from the floor


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("textures/wood.png", "textures/none.png", r"textures/none.png, in bitmap at .*line \d"),
        ("flag.obj", "none.obj", "none.obj, in obj at"),
        ("roughconductor", "unobtainium", 'Plugin "unobtainium" not found'),
        ("</bsdf></bsdf>", "</bsdf>", "failed: Start-end tags mismatch .line"),
        ("$max_depth", "$deepest", r"undefined parameter: \$deepest"),
        ('id="Gold">\n', 'id="Silver">\n', 'unresolved reference to "Gold"'),
        ('type="perspective"', 'type="orthographic"', "orthographic is not supported.*pinhole"),
        ('id="Ball">', 'id="Ball"><medium name="interior" type="homogeneous"/>',
         "participating medium"),
        ("17, 12, 4", "0, 0, 0", "sees only black"),
        (LAMP, "", "no light"),
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
    check_refused(UserSceneOptions(room), match)


def test_a_scene_without_a_sensor_needs_matrices(room):
    bare = BODY[: BODY.index("<sensor")] + BODY[BODY.index("</sensor>") + len("</sensor>") :]
    check_refused(UserSceneOptions(document(room.parent, bare)), "has no camera.*JSON")
    clip = ensure_user_clip(UserSceneOptions(room, flown(room.parent, PASSING)), PRESET)
    assert read_header(clip).frames == 3


@pytest.mark.parametrize(
    ("code", "match"),
    [
        ("x = 1", "neither scene.*nor SCENE"),
        ("def scene():\n    return 3", "returned int, expected Scene"),
        ("def scene():\n    return 1 / 0", "line 2: ZeroDivisionError"),
        ("def scene(:", "SyntaxError"),
        (PYTHON.replace("room()", "looking_down({'type': 'unobtainium'})"),
         "cannot trace.*unobtainium"),
        (HOOK.replace('{"Flag"', '{"Pole"'), "moves 'Pole', .*: Flag"),
        (HOOK.replace('{"Flag"', '{"Ball"'), "moves 'Ball'"),
        (HOOK.replace('rest["Flag"] +', ""), r"shape \[3\], expected finite.*\[3, 3\]"),
        (HOOK.replace("0.1", "float('nan')"), "expected finite"),
        (HOOK.replace("return {", "return time < 2 and {"), "returned bool"),
        (HOOK.replace("return {", "return {} if time > 1 else {"), "moves nothing, but at time 0"),
    ],
)  # fmt: skip
def test_an_unusable_python_file_is_refused(room, code, match):
    file = room.with_name("mine.py")
    file.write_text(code)
    check_refused(UserSceneOptions(file, "still"), match)


@pytest.mark.parametrize(
    ("name", "parameters", "match"),
    [
        ("none.xml", (), "render takes"),
        ("textures/wood.png", (), "render takes"),
        ("scene.xml", (("colour", "red"),), "unused parameters"),
    ],
)
def test_a_file_that_is_not_a_scene_and_an_unknown_parameter_are_refused(
    room, name, parameters, match
):
    check_refused(UserSceneOptions(room.parent / name, parameters=parameters), match)
