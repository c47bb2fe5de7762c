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


def test_numbers_of_srgb_are_decoded_in_either_quotes():
    text, _ = repair_text("<srgb value='0.5, 0 1' name='a'/>")
    assert text == "<rgb value='0.214041 0 1' name='a'/>"


def test_a_file_without_old_colours_is_unchanged():
    text = '<rgb name="a" value="0.1, 0.2, 0.3"/><string name="b" value="#ffff6a"/>'
    assert repair_text(text) == (text, [])


def _radiance(folder, bsdf, version="0.6.0", skip_missing=False):
    """Mean reflected radiance of a square that faces the camera under equal light of 1."""
    body = f'{bsdf}<shape type="rectangle"><ref id="b"/></shape><emitter type="constant"/>'
    file = XmlFile(document(folder, body, version), (), skip_missing)
    camera = Camera((0, 0, 3), (0, 0, 0), (0, 1, 0), 20)
    scene = Scene("s", "s", (), lambda time: camera, max_depth=2, xml_file=file)
    return open_tracer(scene, 8, 8).trace_mean(256, "pilot").mean((0, 1))


@pytest.mark.parametrize(
    ("bsdf", "albedo", "kind"),
    [
        (
            '<bsdf type="ward" id="b"><rgb name="diffuseReflectance" value="0.5 0.3 0.1"/><rgb '
            'name="specularReflectance" value="0.4"/><float name="alphaV" value="0.2"/></bsdf>',
            (0.9, 0.7, 0.5),
            "a blend of diffuse and roughconductor",
        ),
        ('<bsdf type="ward" id="b"/>', (0.7, 0.7, 0.7), "a blend of diffuse and roughconductor"),
        (
            '<bsdf type="ward" id="b"><rgb name="diffuseReflectance" value="0 0 0"/><rgb '
            'name="specularReflectance" value="0.9 0.8 0.7"/><string name="variant" '
            'value="balanced"/></bsdf>',
            (0.9, 0.8, 0.7),
            "roughconductor",
        ),
        (
            '<bsdf type="phong" id="b"><float name="exponent" value="200"/><spectrum '
            'name="specularReflectance" value="0"/></bsdf>',
            (0.5, 0.5, 0.5),
            "a blend of diffuse and roughconductor",
        ),
    ],
)
def test_an_old_glossy_bsdf_keeps_the_sum_of_its_reflectances(llvm, tmp_path, bsdf, albedo, kind):
    # 16384 samples, and a microfacet lobe of roughness 0.2 loses about 1 % to masking
    np.testing.assert_allclose(_radiance(tmp_path, bsdf), albedo, atol=0.015)
    notes = xml_scene.read_settings(XmlFile(tmp_path / "scene.xml")).notes
    name = bsdf.split('"')[1]
    assert notes == [f"BSDF {name} is rendered as {kind} (line 1)"]


@pytest.mark.parametrize(
    "property_",
    [
        '<string name="filterType" value="trilinear"/>',
        '<string name="wrapModeU" value="clamp"/><string name="wrapModeV" value="clamp"/>',
        '<float name="maxAnisotropy" value="8"/>',
    ],
)
def test_old_properties_of_a_texture_are_accepted_without_a_note(llvm, tmp_path, property_):
    bsdf = (
        '<bsdf type="diffuse" id="b"><texture name="reflectance" type="bitmap"><string '
        f'name="filename" value="textures/wood.png"/>{property_}</texture></bsdf>'
    )
    assert 0.1 < _radiance(tmp_path, bsdf).mean() < 0.5
    assert not xml_scene.read_settings(XmlFile(tmp_path / "scene.xml")).notes


def test_a_texture_of_gamma_1_is_linear(llvm, tmp_path):
    import mitsuba as mi

    bsdf = (
        '<bsdf type="diffuse" id="b"><texture name="reflectance" type="bitmap"><string '
        'name="filename" value="grey.png"/><float name="gamma" value="1"/></texture></bsdf>'
    )
    mi.Bitmap(np.full((4, 4, 3), 102, np.uint8)).write(str(tmp_path / "grey.png"))
    np.testing.assert_allclose(_radiance(tmp_path, bsdf), 102 / 255, atol=0.01)


def test_a_property_that_is_ignored_is_said_with_its_lines(llvm, tmp_path):
    flag = '<shape type="obj"><string name="filename" value="flag.obj"/>{}</shape>\n'
    flags = flag.format('<float name="maxSmoothAngle" value="30"/>') * 2
    notes = _settings(tmp_path, flags).notes
    assert notes == ["max_smooth_angle of obj is ignored (line 1, 2)"]


@pytest.mark.parametrize("skip_missing", [False, True])
def test_a_property_that_a_plugin_does_not_read_is_left_out(llvm, tmp_path, skip_missing):
    body = '<shape type="sphere"><float name="radios" value="2"/></shape>'
    (shape,) = _build(tmp_path, body, skip_missing=skip_missing).shapes()
    assert shape.bbox().max.x == pytest.approx(1.0)


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


def test_a_sun_below_the_horizon_is_said_once(llvm, tmp_path, capfd):
    body = (
        '<emitter type="sunsky"><vector name="sunDirection" x="0.5" y="-0.2" z="0.5"/></emitter>'
        '<shape type="sphere"/>'
    )
    assert _settings(tmp_path, body).notes == ["the sun is below the horizon (line 1)"]
    _build(tmp_path, body)
    assert "horizon" not in "".join(capfd.readouterr())  # Mitsuba would say so each time


@pytest.mark.parametrize(
    ("plugin", "scales"), [("sky", (3.0, 0.0)), ("sun", (0.0, 3.0)), ("sunsky", (2.0, 5.0))]
)
def test_an_old_sky_or_sun_is_one_part_of_a_sunsky(llvm, tmp_path, plugin, scales):
    import mitsuba as mi

    names = {"skyScale": 2.0, "sunScale": 5.0} if plugin == "sunsky" else {"scale": 3.0}
    numbers = "".join(f'<float name="{k}" value="{v}"/>' for k, v in names.items())
    body = (
        f'<emitter type="{plugin}"><vector name="sunDirection" x="0.1" y="1" z="0"/>{numbers}'
        '<integer name="resolution" value="64"/></emitter><shape type="sphere"/>'
    )
    found = mi.traverse(_build(tmp_path, body).environment())
    assert (found["sky_scale"], found["sun_scale"]) == scales


def test_a_wider_sun_is_the_sun_with_its_light(llvm, tmp_path):
    def light(radius):
        sun = (
            '<emitter type="sun"><vector name="sunDirection" x="0" y="0.5" z="1"/>'
            f'<float name="sunRadiusScale" value="{radius}"/></emitter>'
        )
        body = '<shape type="rectangle"/>' + sun
        camera = Camera((0, 0, 3), (0, 0, 0), (0, 1, 0), 20)
        file = XmlFile(document(tmp_path / str(radius), body))
        scene = Scene("s", "s", (), lambda time: camera, max_depth=2, xml_file=file)
        return open_tracer(scene, 8, 8).trace_mean(256, "pilot").mean()

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
    ("bsdf", "albedo", "kind"),
    [
        (
            f'<bsdf type="diffuse" id="b">{TEXTURE.format("reflectance")}</bsdf>',
            0.5,
            "textures made grey",
        ),
        (
            f'<bsdf type="bumpmap" id="b">{TEXTURE.format("map")}{WHITE}</bsdf>',
            0.8,
            "surfaces made smooth",
        ),
        (
            f'<bsdf type="normalmap" id="b">{TEXTURE.format("normalmap")}{WHITE}</bsdf>',
            0.8,
            "surfaces made smooth",
        ),
        (
            '<bsdf type="measured" id="b"><string name="filename" value="gone.png"/></bsdf>',
            0.5,
            "BSDFs made grey",
        ),
    ],
)
def test_what_stands_for_a_missing_file_has_the_value_that_is_said(
    llvm, tmp_path, bsdf, albedo, kind
):
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


def test_a_light_of_a_missing_shape_is_said(llvm, tmp_path):
    body = (
        '<shape type="sphere"/><shape type="obj"><string name="filename" value="gone.obj"/>'
        '<emitter type="area"/></shape>'
    )
    notes = _settings(tmp_path, body, skip_missing=True).notes
    assert notes == ["lights left out, because files are missing: 1 (gone.obj)"]
    assert not _build(tmp_path, body, skip_missing=True).emitters()


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


def test_a_parameter_without_a_default_names_the_option(llvm, tmp_path):
    with pytest.raises(SceneError, match=r"undefined parameter: \$method. -D NAME=VALUE"):
        _settings(tmp_path, '<shape type="$method"/>')


@pytest.mark.skipif(not MIRROR.is_dir(), reason="RLBENCH_SCENES names no folder of scenes")
@pytest.mark.parametrize("folder", sorted(MIRROR.glob("*/scene.xml")), ids=lambda f: f.parent.name)
def test_every_scene_of_the_mirror_opens_from_its_original_file(llvm, folder):
    file = XmlFile(folder, (), skip_missing=True)
    assert xml_scene.read_settings(file).camera_to_world is not None
    assert len(xml_scene.build_scene(file, merge=True).shapes()) > 5
