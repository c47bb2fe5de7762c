"""XML files as people have them: what Mitsuba's parser would refuse, and that it renders anyway."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.apps.render.mitsuba import xml_scene
from rlbench.apps.render.mitsuba.xml_text import find_replaced, repair_syntax
from rlbench.apps.render.scene import SceneError, XmlFile
from rlbench.apps.render.user.camera_path import straighten
from rlbench.apps.render.user.scene_file import open_scene_file
from tests.apps.render.user.xml_room import BODY, document

LOOK = '<lookat origin="0, 1.2, 4" target="0, 0.8, 0" up="0, 1, 0"/>'
NORMALS = "v 1 0 -1\nv 2 0 -1\nv 1.5 1 -1\nvn 0 0 1\nf 1//1 2//9 3//1\n"  # normal 9 is missing


def _open(folder, old, new, **more):
    assert BODY.count(old) == 1
    scene = open_scene_file(document(folder, BODY.replace(old, new)), **more)
    scene.sensor_matrix()
    xml_scene.build_scene(scene.scene.xml_file, True)
    return scene


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ("<lookat", "<lookAt", ""),
        ("<lookat", "<look_at", ""),
        (LOOK, '<rotate x="0" y="0" z="0" angle="0"/>' + LOOK, ""),
        ('<rgb name="radiance" value="17, 12, 4"/>',
         '<spectrum name="radiance" value="17, 12, 4"/>', "1 spectra of three numbers"),
        ('<rgb name="radiance" value="17, 12, 4"/>',
         '<spectrum name="radiance" value="#ff8000"/>', "1 spectra of three numbers"),
        ('<integrator type="path">', '<integrator type="$guide">', "guide has no value"),
        ('name="sampleCount" value="64"', 'name="sampleCount" value="$spp"', "spp has no value"),
        ('name="sampleCount" value="64"', 'name="sampleCount" value="99999999999"', ""),
        ('<float name="alpha" value="0.2"/>',
         '<float name="alpha" value="0.2"/><float name="alpha" value="0.3"/>', "given twice"),
        ("textures/wood.png", "Textures/WOOD.png", "other case"),
        ("textures/wood.png", "textures\\wood.png", "other case or slashes"),
        # a transform of 0.6 applies its elements in order, so the mirror comes before the look-at
        (LOOK, '<scale x="-1"/>' + LOOK, "mirrors the image"),
    ],
)  # fmt: skip
def test_a_file_that_people_have_is_rendered_with_a_note(llvm, tmp_path, old, new, note):
    notes = _open(tmp_path, old, new).notes
    assert any(note in each for each in notes) if note else not notes


def test_a_file_without_a_version_is_read_as_the_one_of_its_names(llvm, tmp_path):
    file = document(tmp_path)
    file.write_text(file.read_text().replace(' version="0.6.0"', ""))
    assert any("read as 0.6.0" in note for note in open_scene_file(file).notes)


def test_a_parameter_of_another_part_still_needs_a_value(llvm, tmp_path):
    with pytest.raises(SceneError, match=r"undefined parameter: \$size.*-D NAME=VALUE"):
        _open(tmp_path, 'value="0.2"', 'value="$size"')
    text = '<scene><film><integer name="width" value="$w"/></film><float value="$w"/></scene>'
    assert find_replaced(text, ()) == ({}, [])
    assert find_replaced("<scene", ()) == ({}, [])  # Mitsuba says what is wrong


@pytest.mark.parametrize("kind", ["normalmap", "bumpmap"])
@pytest.mark.parametrize("skip_missing", [False, True])
def test_a_map_with_a_file_gets_a_texture(llvm, tmp_path, kind, skip_missing):
    name = "none.png" if skip_missing else "textures/wood.png"
    used = (
        f'<bsdf type="{kind}" id="W"><string name="filename" value="{name}"/>'
        '<bsdf type="diffuse"/></bsdf><shape type="sphere"><ref id="W"/></shape>'
    )
    old = '<bsdf type="twosided" id="Wood">'
    notes = _open(tmp_path, old, used + old, skip_missing=skip_missing).notes
    assert any("made smooth" in note for note in notes) == skip_missing


def test_a_broken_mesh_is_left_out_with_skip_missing_alone(llvm, tmp_path, capfd):
    file = document(tmp_path)
    (tmp_path / "flag.obj").write_text(NORMALS)
    with pytest.raises(SceneError, match="flag.obj"):
        xml_scene.build_scene(XmlFile(file), True)
    scene = xml_scene.build_scene(XmlFile(file, skip_missing=True), False)
    assert "Flag" not in {shape.id() for shape in scene.shapes()}
    assert "a shape is left out" in "".join(capfd.readouterr())


def test_a_sensor_that_is_rigid_to_one_percent_becomes_rigid():
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    matrix = np.eye(4)
    matrix[:3, :3] = turn * 1.008
    straight, notes = straighten(matrix)
    np.testing.assert_allclose(straight[:3, :3], turn, atol=1e-12)
    assert len(notes) == 1
    matrix[:3, :3] = turn * 1.1  # 10 %: stays, and is refused later
    assert straighten(matrix)[0] is matrix


def test_a_good_file_is_unchanged():
    text = f'<scene version="0.6.0">{BODY}</scene>'
    assert repair_syntax(text) == (text, [])
