"""XML files as they are found: what is repaired, and that the repaired value is the right one."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from kornia.color import rgb_to_linear_rgb

from rlbench.apps.render.mitsuba import xml_scene
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.xml_repairs import repair_text
from rlbench.apps.render.scene import Camera, Scene, SceneError, XmlFile
from rlbench.apps.render.user.clip import UserSceneOptions, ensure_user_clip
from rlbench.clips.header import read_header
from tests.apps.render.user.xml_room import BODY, PRESET, document

MIRROR = Path(os.environ.get("RLBENCH_SCENES", "/nowhere"))


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


def test_numbers_of_srgb_are_decoded_in_either_quotes_and_others_are_unchanged():
    text, _ = repair_text("<srgb value='0.5, 0 1' name='a'/>")
    assert text == "<rgb value='0.214041 0 1' name='a'/>"
    text = '<rgb name="a" value="0.1, 0.2, 0.3"/><string name="b" value="#ffff6a"/>'
    assert repair_text(text) == (text, [])


def _radiance(folder, bsdf, skip_missing=False, light='<emitter type="constant"/>'):
    """Mean reflected radiance of a square that faces the camera, by default under a light of 1."""
    body = f'{bsdf}<shape type="rectangle"><ref id="b"/></shape>{light}'
    file = XmlFile(document(folder, body), (), skip_missing)
    camera = Camera((0, 0, 3), (0, 0, 0), (0, 1, 0), 20)
    scene = Scene("s", "s", (), lambda time: camera, max_depth=2, xml_file=file)
    return open_tracer(scene, 8, 8).trace_mean(256, "pilot").mean((0, 1))


DIFFUSE, SPECULAR = ("rgb", "diffuseReflectance"), ("rgb", "specularReflectance")
BLEND = "a blend of diffuse and roughconductor"


@pytest.mark.parametrize(
    ("plugin", "properties", "albedo", "kind"),
    [
        ("ward", [(*DIFFUSE, ".5 .3 .1"), (*SPECULAR, "0.4")], (0.9, 0.7, 0.5), BLEND),
        ("ward", [("float", "alphaV", "0.2")], (0.7, 0.7, 0.7), BLEND),
        (
            "ward",
            [(*DIFFUSE, "0 0 0"), (*SPECULAR, ".9 .8 .7"), ("string", "variant", "balanced")],
            (0.9, 0.8, 0.7),
            "roughconductor",
        ),
        (
            "phong",
            [("float", "exponent", "200"), ("spectrum", SPECULAR[1], "0")],
            (0.5, 0.5, 0.5),
            BLEND,
        ),
    ],
)
def test_an_old_glossy_bsdf_keeps_the_sum_of_its_reflectances(
    llvm, tmp_path, plugin, properties, albedo, kind
):
    inner = "".join(f'<{kind} name="{name}" value="{value}"/>' for kind, name, value in properties)
    bsdf = f'<bsdf type="{plugin}" id="b">{inner}</bsdf>'
    # 16384 samples, and a microfacet lobe of roughness 0.2 loses about 1 % to masking
    np.testing.assert_allclose(_radiance(tmp_path, bsdf), albedo, atol=0.015)
    notes = xml_scene.read_settings(XmlFile(tmp_path / "scene.xml")).notes
    assert notes == [f"BSDF {plugin} is rendered as {kind} (line 1)"]


WOOD = (
    '<bsdf type="diffuse" id="b"><texture name="reflectance" type="bitmap"><string '
    'name="filename" value="textures/wood.png"/>{}</texture></bsdf>'
)


@pytest.mark.parametrize(
    "property_",
    [
        '<string name="filterType" value="trilinear"/>',
        '<string name="wrapModeU" value="clamp"/><string name="wrapModeV" value="clamp"/>',
        '<float name="maxAnisotropy" value="8"/>',
    ],
)
def test_old_properties_of_a_texture_are_accepted_without_a_note(llvm, tmp_path, property_):
    assert 0.1 < _radiance(tmp_path, WOOD.format(property_)).mean() < 0.5
    assert not xml_scene.read_settings(XmlFile(tmp_path / "scene.xml")).notes


def test_a_texture_of_gamma_1_is_linear(llvm, tmp_path):
    import mitsuba as mi

    bsdf = WOOD.format('<float name="gamma" value="1"/>').replace("textures/wood", "grey")
    mi.Bitmap(np.full((4, 4, 3), 102, np.uint8)).write(str(tmp_path / "grey.png"))
    np.testing.assert_allclose(_radiance(tmp_path, bsdf), 102 / 255, atol=0.01)


FLAG = '<shape type="obj"><string name="filename" value="flag.obj"/>{}</shape>\n'
SUN = '<shape type="sphere"/><emitter type="sunsky"><vector name="sunDirection" {}/></emitter>'
NOTED = {
    "max_smooth_angle of obj is ignored (line 1, 2)": FLAG.format(
        '<float name="maxSmoothAngle" value="30"/>'
    )
    * 2,
    "the sun is below the horizon (line 1)": SUN.format('x="0.5" y="-0.2" z="0.5"'),
    "lights left out, because files are missing: 1 (gone.obj)": FLAG.format(
        '<emitter type="area"/>'
    ).replace("flag", "gone"),
}


@pytest.mark.parametrize("note", NOTED)
def test_what_is_ignored_or_left_out_is_said_once_with_its_lines(llvm, tmp_path, capfd, note):
    assert _settings(tmp_path, NOTED[note], skip_missing=True).notes == [note]
    scene = _build(tmp_path, '<shape type="sphere"/>' + NOTED[note], skip_missing=True)
    assert bool(scene.emitters()) == ("sun" in note)
    assert "horizon" not in "".join(capfd.readouterr())  # Mitsuba would say so each time


@pytest.mark.parametrize("skip_missing", [False, True])
def test_a_property_that_a_plugin_does_not_read_is_left_out(llvm, tmp_path, capfd, skip_missing):
    body = '<shape type="sphere"><float name="radios" value="2"/></shape>'
    (shape,) = _build(tmp_path, body, skip_missing=skip_missing).shapes()
    assert shape.bbox().max.x == pytest.approx(1.0)
    assert "radios" in "".join(capfd.readouterr())


def test_the_index_of_a_metal_in_glass_is_relative_to_the_glass(llvm, tmp_path):
    import mitsuba as mi

    body = (
        '<bsdf type="conductor" id="b"><float name="eta" value="0.3"/><float name="k" value="3"/>'
        '<float name="extEta" value="1.5"/></bsdf><shape type="rectangle"><ref id="b"/></shape>'
    )
    assert not _settings(tmp_path, body).notes
    parameters = mi.traverse(_build(tmp_path, body))
    values = {k.split(".")[-2]: np.array(v).ravel() for k, v in parameters if k.endswith("value")}
    np.testing.assert_allclose(values["eta"], 0.3 / 1.5, rtol=1e-5)
    np.testing.assert_allclose(values["k"], 3 / 1.5, rtol=1e-5)


@pytest.mark.parametrize(
    ("version", "name", "up", "horizon"),
    [
        ("0.5.0", "sunDirection", (0.0, 1.0, 0.0), (0.8, 0.05, 0.6)),
        ("3.0.0", "sun_direction", (0.0, 0.0, 1.0), (0.8, 0.6, 0.05)),
    ],
)
def test_the_sky_is_up_where_the_version_of_the_file_has_it(
    llvm, tmp_path, version, name, up, horizon
):
    import mitsuba as mi

    body = SUN.format(f'x="{up[0] + 0.1}" y="{up[1]}" z="{up[2]}"').replace("sunDirection", name)
    environment = _build(tmp_path, body, version).environment()

    def radiance(direction):
        surface = mi.SurfaceInteraction3f()
        surface.wi = mi.Vector3f(*[-v for v in direction])
        return float(np.mean(np.array(environment.eval(surface))))

    assert radiance([-v for v in up]) == 0  # below the horizon
    assert radiance(horizon) > 0


@pytest.mark.parametrize(
    ("plugin", "scales"), [("sky", (3.0, 0.0)), ("sun", (0.0, 3.0)), ("sunsky", (2.0, 5.0))]
)
def test_an_old_sky_or_sun_is_one_part_of_a_sunsky(llvm, tmp_path, plugin, scales):
    import mitsuba as mi

    names = {"skyScale": 2.0, "sunScale": 5.0} if plugin == "sunsky" else {"scale": 3.0}
    numbers = "".join(f'<float name="{k}" value="{v}"/>' for k, v in names.items())
    numbers += '<integer name="resolution" value="64"/></emitter>'
    body = SUN.format('x="0.1" y="1" z="0"').replace("sunsky", plugin)
    body = body.replace("</emitter>", numbers)
    found = mi.traverse(_build(tmp_path, body).environment())
    assert (found["sky_scale"], found["sun_scale"]) == scales


def test_a_wider_sun_is_the_sun_with_its_light(llvm, tmp_path):
    def light(radius):
        sun = (
            '<emitter type="sun"><vector name="sunDirection" x="0" y="0.5" z="1"/>'
            f'<float name="sunRadiusScale" value="{radius}"/></emitter>'
        )
        return _radiance(tmp_path / str(radius), '<bsdf type="diffuse" id="b"/>', light=sun).mean()

    assert light(1) > 0
    assert light(15) == pytest.approx(light(1), rel=0.02)


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
    assert messages[0] == "shapes left out, because files are missing: 1 (gone.obj)"


TEXTURE = (
    '<texture name="{}" type="bitmap"><string name="filename" value="gone.png"/><string '
    'name="filterType" value="trilinear"/></texture>'
)
WHITE = '<bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>'


@pytest.mark.parametrize(
    ("plugin", "inner", "albedo", "kind"),
    [
        ("diffuse", TEXTURE.format("reflectance"), 0.5, "textures made grey"),
        ("bumpmap", TEXTURE.format("map") + WHITE, 0.8, "surfaces made smooth"),
        ("normalmap", TEXTURE.format("normalmap") + WHITE, 0.8, "surfaces made smooth"),
        ("measured", '<string name="filename" value="gone.png"/>', 0.5, "BSDFs made grey"),
    ],
)
def test_what_stands_for_a_missing_file_has_the_value_that_is_said(
    llvm, tmp_path, plugin, inner, albedo, kind
):
    bsdf = f'<bsdf type="{plugin}" id="b">{inner}</bsdf>'
    image = _radiance(tmp_path, bsdf, skip_missing=True)
    np.testing.assert_allclose(image, albedo, atol=0.01)  # 16384 samples of deviation 0.2
    settings = xml_scene.read_settings(XmlFile(tmp_path / "scene.xml", skip_missing=True))
    assert settings.notes == [f"{kind}, because files are missing: 1 (gone.png)"]
    assert settings.missing_files == ("gone.png",)


def test_a_missing_environment_map_is_an_equal_radiance_of_its_scale(llvm, tmp_path):
    import mitsuba as mi

    body = (
        '<shape type="sphere"/><emitter type="envmap"><string name="filename" value="gone.exr"/>'
        '<float name="scale" value="3"/><transform name="toWorld"><rotate y="1" angle="90"/>'
        "</transform></emitter>"
    )
    environment = _build(tmp_path, body, skip_missing=True).environment()
    radiance = environment.eval(mi.SurfaceInteraction3f())
    np.testing.assert_allclose(np.array(radiance).ravel(), 3)


@pytest.mark.parametrize("method", ["sppm", "path_guiding_integrator"])
def test_an_integrator_that_mitsuba_lacks_is_replaced(llvm, tmp_path, method):
    body = (
        f'<default name="method" value="{method}"/><integrator type="$method"><integer '
        'name="maxDepth" value="7"/><boolean name="dualBuffer" value="true"/></integrator>'
        '<shape type="sphere"/>'
    )
    settings = _settings(tmp_path, body)
    assert settings.max_depth == 7
    assert settings.notes == [f"integrator {method} is replaced by path"]
    assert len(_build(tmp_path, body).shapes()) == 1


@pytest.mark.skipif(not MIRROR.is_dir(), reason="RLBENCH_SCENES names no folder of scenes")
@pytest.mark.parametrize("folder", sorted(MIRROR.glob("*/scene.xml")), ids=lambda f: f.parent.name)
def test_every_scene_of_the_mirror_opens_from_its_original_file(llvm, folder):
    file = XmlFile(folder, (), skip_missing=True)
    assert xml_scene.read_settings(file).camera_to_world is not None
    assert len(xml_scene.build_scene(file, merge=True).shapes()) > 5
