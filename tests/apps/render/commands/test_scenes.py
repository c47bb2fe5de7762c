"""The command scenes: its list, downloads of several scenes, and pins."""

from __future__ import annotations

import dataclasses
import json

import pytest
from typer.testing import CliRunner

from rlbench.apps.render.scenes.collection.catalog import load_catalog, pins_folder
from rlbench.apps.render.scenes.collection.download import get
from rlbench.cli.app import app
from rlbench.cli.json_output import ScenesOutput
from rlbench.system import paths
from tests.cli.runner import rlbench
from tests.scene_server import FILES, FOLDER, OWNER


@pytest.fixture
def server(server, monkeypatch):
    """The server, as the variables of the environment name it."""
    monkeypatch.setenv("RLBENCH_SCENES_URL", f"{server.address}/")
    monkeypatch.setenv("RLBENCH_SCENES_API", server.address)
    monkeypatch.setitem(get.__kwdefaults__, "pause_s", 0.0)
    return server


def document(*words: object) -> dict[str, object]:
    return json.loads(CliRunner().invoke(app, [*map(str, words), "--json"]).stdout)


def test_the_list_and_its_document_have_every_scene_with_its_author_licence_and_state(server):
    output = rlbench("scenes")
    for words in ("Japanese Classroom", "NovaZeeke", "CC BY 3.0", "not downloaded", "not pinned"):
        assert words in output
    found = document("scenes")
    assert found.keys() == {field.name for field in dataclasses.fields(ScenesOutput)}
    rows = {row["name"]: row for row in found["scenes"]}
    assert rows.keys() == load_catalog().keys()
    assert rows["attic"]["bytes"] == sum(map(len, FILES.values()))
    assert rows["kitchen"]["has_unknown_sizes"]


def test_a_scene_is_downloaded_and_credited(server, tmp_path):
    output = rlbench("scenes", "get", "attic")
    assert "4 downloaded, 0 copied, 0 there already; 'attic' by unknown" in output
    (row,) = document("scenes", "get", "attic")["scenes"]
    assert row["state"] == "complete"
    assert row["scene"] == str(paths.scenes_folder() / "attic" / "scene.xml")
    rlbench("scenes", "get", "attic", "--out", tmp_path / "mirror")
    assert (tmp_path / "mirror" / "attic" / "scene.xml").exists()


def test_one_scene_that_fails_does_not_keep_others_from_being_downloaded(server):
    server.write_pin().rename(pins_folder() / "loft.tsv")
    pin = server.write_pin()
    pin.write_text(pin.read_text().replace(FOLDER, "scenes/gone"))
    output = rlbench("scenes", "get", "attic,loft", code=1)
    assert "4 of 4 files of attic cannot be downloaded" in output
    assert "loft: 4 downloaded" in output
    assert output.endswith("1 of 2 scenes are not complete: attic")
    assert "attic" in document("scenes", "get", "attic")["failed"]


def test_a_server_that_is_down_stops_at_the_first_scene(server, monkeypatch):
    monkeypatch.setenv("RLBENCH_SCENES_URL", "http://127.0.0.1:9")
    output = rlbench("scenes", "get", "all", code=1)
    assert "left out, since not pinned: dining-room, bathroom2" in output
    assert output.count("cannot be reached") == 1
    assert "16 of 16 scenes are not complete: living-room, classroom" in output


def test_a_scene_is_pinned_and_can_then_be_downloaded(server, tmp_path):
    expected = server.write_pin().read_text()
    own, place = pins_folder() / "attic.tsv", f"{OWNER}@{server.commit}:{FOLDER}"
    own.unlink()
    output = rlbench("scenes", "pin", place)
    assert f"{own}: 4 files to download them: rlbench scenes get" in output
    assert "4 downloaded" in rlbench("scenes", "get", "attic")
    rlbench("scenes", "pin", place, "--out", tmp_path / "mine.tsv")
    assert (tmp_path / "mine.tsv").read_text() == expected


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (("get", "atic"), "Did you mean 'attic'?"),
        (("get", "staircase"), "Pin them: rlbench scenes pin staircase"),
        (("get",), "which scenes? rlbench scenes get NAME, or all"),
        (("list", "attic"), "a list takes no names"),
        (("pin", "kitchen"), "kitchen is pinned already. To write another pin: --out FILE"),
        (("pin",), "pin one scene"),
        (("gett", "attic"), "Did you mean 'get'?"),
    ],
)
def test_wrong_words_are_answered_with_what_to_write(server, words, answer):
    assert answer in rlbench("scenes", *words, code=2)


def test_the_cache_lists_scenes_and_prune_keeps_files_of_the_user(server):
    rlbench("scenes", "get", "attic")
    (paths.scenes_folder() / "attic" / "notes.md").write_text("mine")
    found = document("cache")
    kinds = {entry["kind"]: entry for entry in found["entries"]}
    assert kinds["scenes by others"]["files"] == len(FILES) + 1
    assert kinds["scenes by others"]["remade_by"] == "rlbench scenes get"
    assert kinds["pins of scenes"]["files"] == 1
    assert found["unknown"] == [str(paths.scenes_folder() / "attic" / "notes.md")]
