"""XML files as they are found: what is repaired, and that the repaired value is the right one."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from kornia.color import rgb_to_linear_rgb

from rlbench.clips.stored import read_header
from rlbench.render.mitsuba import xml_scene
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.render.mitsuba.xml_repairs import repair_text
from rlbench.render.scene import Camera, Scene, SceneError, XmlFile
from rlbench.render.user.clip import UserSceneOptions, ensure_user_clip
from tests.render.user.xml_room import BODY, PRESET, document

MIRROR = Path(os.environ.get("RLBENCH_SCENES", "/nowhere"))
COPPER = '<rgb name="eta" value="0.2 0.9 1.1"/><rgb name="k" value="3.9 2.5 2.3"/>'


def _settings(folder, body, version="0.6.0", skip_missing=False):
    file = document(folder, body, version)
    return xml_scene.read_settings(XmlFile(file, skip_missing=skip_missing))


def _build(folder, body, version="0.6.0", skip_missing=False):
    return xml_scene.build_scene(XmlFile(document(folder, body, version), (), skip_missing), True)


@pytest.mark.parametrize("element", ["rgb", "srgb"])
@pytest.mark.parametrize("color", ["#ffff6a", "#00807F"])
def test_a_hexadecimal_colour_is_decoded_from_srgb(element, color):
    text, notes = repair_text(f'<{element} name="reflectance" value="{color}"/>')
    values = torch.tensor([int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    expected = rgb_to_linear_rgb(values.view(1, 3, 1, 1)).flatten()
    found = [float(v) for v in text.split('value="')[1].split('"')[0].split()]
    np.testing.assert_allclose(found, expected, rtol=1e-4)  # kornia computes in float32
    assert notes == ["1 sRGB colours are converted to linear numbers"]


def test_a_file_without_old_colours_is_unchanged():
    text = '<rgb name="a" value="0.1, 0.2, 0.3"/><string name="b" value="#ffff6a"/>'
    assert repair_text(text) == (text, [])


@pytest.mark.parametrize(
    ("bsdf", "note"),
    [
        (f'<bsdf type="roughconductor" id="b">{COPPER}<float name="extEta" value="1"/></bsdf>', ""),
        (f'<bsdf type="conductor" id="b">{COPPER}<float name="extEta" value="1.5"/></bsdf>', ""),
        (
            '<bsdf type="ward" id="b"><rgb name="diffuseReflectance" value="0.5"/>'
            '<float name="alphaU" value="0.1"/><float name="alphaV" value="0.2"/></bsdf>',
            "BSDF ward is rendered as roughplastic",
        ),
        (
            '<bsdf type="ward" id="b"><rgb name="diffuseReflectance" value="0 0 0"/>'
            '<rgb name="specularReflectance" value="0.9 0.8 0.7"/>'
            '<string name="variant" value="balanced"/></bsdf>',
            "BSDF ward is rendered as roughconductor",
        ),
        (
            '<bsdf type="phong" id="b"><float name="exponent" value="20"/></bsdf>',
            "BSDF phong is rendered as roughplastic",
        ),
        (
            '<bsdf type="diffuse" id="b"><texture name="reflectance" type="bitmap"><string '
            'name="filename" value="textures/wood.png"/><string name="filterType" '
            'value="trilinear"/></texture></bsdf>',
            "",
        ),
    ],
)
def test_a_bsdf_of_an_older_version_is_rendered_by_the_nearest_one(llvm, tmp_path, bsdf, note):
    body = f'{bsdf}<shape type="rectangle"><ref id="b"/></shape><emitter type="constant"/>'
    notes = _settings(tmp_path, body).notes
    assert (note in "; ".join(notes)) if note else not notes
    scene = Scene(
        "s", "s", (), lambda time: Camera((0, 0, 3), (0, 0, 0), (0, 1, 0), 20), max_depth=3
    )
    file = XmlFile(tmp_path / "scene.xml")
    image = open_tracer(replace(scene, xml_file=file), 8, 8).trace_mean(64, "pilot")
    assert 0.05 < image.mean() <= 1.01  # nothing black, no light gained


def test_the_index_of_a_metal_in_glass_is_relative_to_the_glass(llvm, tmp_path):
    import mitsuba as mi

    body = (
        '<bsdf type="conductor" id="b"><float name="eta" value="0.3"/><float name="k" value="3"/>'
        '<float name="extEta" value="1.5"/></bsdf><shape type="rectangle"><ref id="b"/></shape>'
    )
    parameters = mi.traverse(_build(tmp_path, body))
    values = {key.split(".")[-2]: float(v[0]) for key, v in parameters if key.endswith("value")}
    assert (values["eta"], values["k"]) == pytest.approx((0.2, 2.0), rel=1e-5)


@pytest.mark.parametrize("version", ["0.5.0", "3.0.0"])
def test_the_sky_is_up_where_the_version_of_the_file_has_it(llvm, tmp_path, version):
    import mitsuba as mi

    up = [0.0, 1.0, 0.0] if version < "3" else [0.0, 0.0, 1.0]
    name = "sunDirection" if version < "3" else "sun_direction"
    body = (
        f'<emitter type="sunsky"><vector name="{name}" x="{up[0] + 0.1}" y="{up[1]}" '
        f'z="{up[2]}"/></emitter><shape type="sphere"/>'
    )
    environment = _build(tmp_path, body, version).environment()

    def radiance(direction):
        surface = mi.SurfaceInteraction3f()
        surface.wi = mi.Vector3f(*[-v for v in direction])
        return float(np.mean(np.array(environment.eval(surface))))

    horizon = [0.8, 0.05, 0.6] if version < "3" else [0.8, 0.6, 0.05]
    assert radiance([-v for v in up]) == 0  # below the horizon
    assert radiance(horizon) > 0


def test_a_sun_below_the_horizon_is_said_once(llvm, tmp_path):
    body = (
        '<emitter type="sunsky"><vector name="sunDirection" x="0.5" y="-0.2" z="0.5"/></emitter>'
        '<shape type="sphere"/>'
    )
    assert _settings(tmp_path, body).notes == ["the sun of sunsky is below the horizon"]


MISSING = BODY.replace("flag.obj", "gone.obj").replace("textures/wood.png", "textures/gone.png")


def test_missing_files_are_an_error_that_names_the_way_out(llvm, tmp_path):
    with pytest.raises(SceneError, match=r"(?s)gone\.png.*gone\.obj.*--skip-missing"):
        _settings(tmp_path, MISSING)


def test_missing_files_are_left_out_counted_and_recorded(room):
    room.write_text(room.read_text().replace("flag.obj", "gone.obj"))
    messages = []
    options = UserSceneOptions(room, "still", frames=1, skip_missing=True)
    clip = ensure_user_clip(options, PRESET, messages.append)
    assert read_header(clip).missing_files == ("gone.obj",)
    assert messages[0].startswith("1 files are missing")


def test_a_missing_texture_is_grey(llvm, tmp_path):
    body = (
        '<bsdf type="diffuse" id="b"><texture name="reflectance" type="bitmap"><string '
        'name="filename" value="gone.png"/></texture></bsdf>'
        '<shape type="rectangle"><ref id="b"/></shape><emitter type="constant"/>'
    )
    file = XmlFile(document(tmp_path, body), (), skip_missing=True)
    camera = Camera((0, 0, 3), (0, 0, 0), (0, 1, 0), 20)
    scene = Scene("s", "s", (), lambda time: camera, max_depth=2, xml_file=file)
    image = open_tracer(scene, 8, 8).trace_mean(256, "pilot")
    assert image.mean() == pytest.approx(0.5, abs=0.01)  # 16384 samples of deviation 0.2


@pytest.mark.skipif(not MIRROR.is_dir(), reason="RLBENCH_SCENES names no folder of scenes")
@pytest.mark.parametrize("folder", sorted(MIRROR.glob("*/scene.xml")), ids=lambda f: f.parent.name)
def test_every_scene_of_the_mirror_opens_from_its_original_file(llvm, folder):
    file = XmlFile(folder, (), skip_missing=True)
    assert xml_scene.read_settings(file).camera_to_world is not None
    assert len(xml_scene.build_scene(file, merge=True).shapes()) > 5
