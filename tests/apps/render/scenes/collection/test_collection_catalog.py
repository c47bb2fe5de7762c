"""The catalog of scenes by others: what ships, what a user pins, and what lies on this machine."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path

import pytest

from rlbench.apps.render.scene import SceneError
from rlbench.apps.render.scenes.collection import catalog
from rlbench.apps.render.scenes.collection.catalog import (
    describe_state,
    digest,
    find_located,
    find_scene,
    load_catalog,
    locate,
)
from rlbench.apps.render.scenes.collection.download import get
from rlbench.apps.render.scenes.collection.pins import blob_id
from rlbench.system import paths
from tests.scene_server import FILES

MIRROR = Path(os.environ.get("RLBENCH_SCENES", ""))


def write_scene(folder: Path) -> Path:
    """The scene of the server, complete, in a folder."""
    for path, content in FILES.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    return folder


def test_ten_of_nineteen_scenes_are_in_the_preset_real():
    entries = load_catalog()
    assert len(entries) == 19
    assert {name for name, entry in entries.items() if "real" in entry.presets} == {
        *("living-room", "classroom", "staircase2", "veach-mis", "cornell_box_picture"),
        *("isometric-room", "office-room", "low-poly-jungle-scene", "shanghai", "snowy-hut"),
    }


@pytest.mark.parametrize("entry", load_catalog().values(), ids=lambda entry: entry.name)
def test_every_scene_says_whom_to_credit_and_where_it_is_from(entry):
    assert "" not in (entry.title, entry.author)
    assert entry.licence in catalog.LICENCES
    assert entry.source.startswith("https://")
    assert re.fullmatch(r"[\w.-]+/[\w.-]+", entry.repository)
    assert re.fullmatch(r"[0-9a-f]{40}", entry.commit)


@pytest.mark.parametrize(
    "entry", [e for e in load_catalog().values() if e.files], ids=lambda entry: entry.name
)
def test_a_shipped_pin_has_the_scene_its_licence_and_nothing_that_is_not_rendered(entry):
    names = {file.path for file in entry.files}
    assert entry.main in names
    licences = {name for name in names if name.lower() in ("license.txt", "readme.md")}
    assert licences
    rest = {Path(name) for name in names - licences - {entry.main}}
    if entry.main.endswith(".xml"):
        assert {path.parts[0] for path in rest} <= {"models", "textures"}
    else:
        assert {path.suffix for path in rest} <= {".bin", ".png", ".jpeg"}
    assert len(names) == len(entry.files)


def test_a_pin_of_the_user_is_a_scene_or_adds_files_to_one_that_ships_without(server):
    entry = find_scene("attic")
    assert (entry.repository, entry.bytes) == ("wig42/rooms", sum(map(len, FILES.values())))
    assert {file.path for file in entry.files} == set(FILES)
    assert "see the folder's LICENSE.txt" in entry.licence
    server.write_pin().rename(catalog.pins_folder() / "staircase.tsv")
    entry = find_scene("staircase")
    assert (entry.author, len(entry.files)) == ("Wig42", len(FILES))


def test_a_scene_that_ships_with_a_pin_keeps_it(server):
    server.write_pin().rename(catalog.pins_folder() / "kitchen.tsv")
    assert find_scene("kitchen").folder == "kitchen"
    with pytest.raises(SceneError, match="kitchen is pinned already"):
        catalog.own_pin_file("kitchen")


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("classroom", "run `rlbench scenes get classroom`"),
        ("staircase", "run `rlbench scenes pin staircase`, then `rlbench scenes get staircase`"),
    ],
)
def test_a_scene_that_lies_nowhere_is_answered_with_the_command_that_gets_it(name, command):
    with pytest.raises(SceneError, match=f"{command}, or set RLBENCH_SCENES to a folder"):
        locate(name)


def test_the_mirror_is_preferred_to_the_download_unless_it_lacks_files(
    server, tmp_path, monkeypatch
):
    downloaded = write_scene(paths.scenes_folder() / "attic")
    mirrored = write_scene(tmp_path / "mirror" / "attic")
    assert locate("attic").scene == downloaded / "scene.xml"
    monkeypatch.setenv("RLBENCH_SCENES", str(tmp_path / "mirror"))
    assert locate("attic").scene == mirrored / "scene.xml"
    (mirrored / "models" / "Mesh000.obj").unlink()
    assert locate("attic").scene == downloaded / "scene.xml"


def test_files_that_are_absent_or_cut_are_missing_under_their_names_in_the_scene(server):
    entry = find_scene("attic")
    assert describe_state(entry, find_located(entry)) == "not downloaded"
    folder = write_scene(paths.scenes_folder() / "attic")
    assert describe_state(entry, find_located(entry)) == "complete"
    (folder / "models" / "Mesh000.obj").write_bytes(b"v 0 0 0\n")
    (folder / "textures" / "oak wall.png").unlink()
    located = locate("attic")
    assert located.missing == ("models/Mesh000.obj", "textures/oak wall.png")
    assert describe_state(entry, located) == "partial: 2 files missing"
    server.write_pin(without_sizes=True)  # then a file is there if it exists
    assert locate("attic").missing == ("textures/oak wall.png",)


def test_the_digest_changes_with_the_pin_and_with_missing_files_and_not_with_the_folder(
    server, tmp_path, monkeypatch
):
    folder = write_scene(paths.scenes_folder() / "attic")
    complete = digest(locate("attic"))
    server.write_pin(**{"scene.xml": "0" * 40})
    assert digest(locate("attic")) != complete
    server.write_pin(without_sizes=True)
    monkeypatch.setenv("RLBENCH_SCENES", str(tmp_path / "mirror"))
    write_scene(tmp_path / "mirror" / "attic")
    assert digest(locate("attic")) == complete
    monkeypatch.delenv("RLBENCH_SCENES")
    (folder / "models" / "Mesh000.obj").unlink()
    assert digest(locate("attic")) != complete


def test_the_digest_of_a_scene_without_a_pin_is_that_of_its_xml():
    folder = paths.scenes_folder() / "staircase"
    folder.mkdir(parents=True)
    digests = set()
    for text in ("<scene/>", "<scene> </scene>", "<scene/>"):
        (folder / "scene.xml").write_text(text)
        digests.add(digest(locate("staircase")))
    assert len(digests) == 2


def test_catalog_and_pins_are_package_data():
    text = (Path(__file__).parents[5] / "pyproject.toml").read_text()
    data = tomllib.loads(text)["tool"]["setuptools"]["package-data"]
    assert "*.toml" in data["*"]
    assert "pins/*.tsv" in data["rlbench.apps.render.scenes.collection"]


@pytest.mark.skipif(not MIRROR.name, reason="RLBENCH_SCENES names no mirror")
def test_files_of_a_real_mirror_have_the_pinned_content(tmp_path, monkeypatch):
    entry = find_scene("staircase2")
    monkeypatch.setenv("RLBENCH_SCENES", str(MIRROR))
    assert get("staircase2", tmp_path).copied == len(entry.files)
    for file in entry.files:
        assert blob_id(tmp_path / "staircase2" / file.path) == file.blob
