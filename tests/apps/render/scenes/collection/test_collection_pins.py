"""Pins: their text, the ids of git, and lists of files from an API that answers as GitHub's."""

from __future__ import annotations

import pytest

from rlbench.apps.render.scene import SceneError
from rlbench.apps.render.scenes.collection.pins import (
    Pin,
    PinnedFile,
    blob_id,
    format_pin,
    parse_place,
    pin,
    read_pin,
)
from tests.scene_server import FOLDER, OWNER

BLOB = "3f380c3de57d6b72735cb71dfb973021495e1a71"


@pytest.mark.parametrize("content", [b"", b"rooms\n", bytes(3_000_000)])
def test_a_blob_id_is_that_of_git(server, tmp_path, content):
    (tmp_path / "file").write_bytes(content)
    assert blob_id(tmp_path / "file") == server.git("hash-object", str(tmp_path / "file")).strip()


def test_a_pin_is_read_as_it_was_written(tmp_path):
    files = (PinnedFile("models/a b.obj", BLOB, 12), PinnedFile("scene.xml", BLOB))
    pinned = Pin("wig42/rooms", "0" * 40, "scenes/the attic", files)
    (tmp_path / "attic.tsv").write_text(format_pin(pinned))
    assert read_pin(tmp_path / "attic.tsv") == pinned


LINE = format_pin(Pin("wig42/rooms", "0" * 40, "attic"))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (f"{LINE}attic/a.obj\t0123\t5\n", "line 2: '0123' is not a git blob id"),
        (f"{LINE}attic/../a.obj\t{BLOB}\t5\n", "line 2: '../a.obj' is not a path inside the scene"),
        (f"{LINE}cellar/a.obj\t{BLOB}\t5\n", "line 2: 'cellar/a.obj' is not in the folder attic"),
        (f"{LINE}attic/a.obj\t{BLOB}\tbig\n", "line 2: invalid literal"),
        (f"{LINE}attic/a.obj\n", "line 2: not enough values"),
        ("", "is not a pin of a scene: its first line is not"),
    ],
)
def test_a_damaged_pin_is_refused_by_its_line(tmp_path, text, reason):
    (tmp_path / "attic.tsv").write_text(text)
    with pytest.raises(SceneError, match=reason):
        read_pin(tmp_path / "attic.tsv")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        *(
            (text, "Give OWNER/REPOSITORY@COMMIT:FOLDER")
            for text in ("wig42/rooms:attic", "a/b@c:/")
        ),
        *((f"a/b@{commit}:attic", "Give all 40 hex digits") for commit in ("main", "8fdb2dcb3fe5")),
    ],
)
def test_a_place_has_a_repository_a_whole_commit_and_a_folder(text, reason):
    with pytest.raises(SceneError, match=reason):
        parse_place(text)


def test_a_folder_is_pinned_as_git_lists_it_without_what_is_not_rendered(server):
    text = pin(OWNER, server.commit, FOLDER, address=server.address)
    assert text == server.write_pin().read_text()
    assert server.listed == [f"{server.commit}?recursive=1"]


@pytest.mark.parametrize("cut", [["HEAD:"], ["HEAD:", "HEAD:scenes"], ["HEAD:", f"HEAD:{FOLDER}"]])
def test_a_list_that_github_cuts_is_completed_by_lists_of_folders(server, cut):
    server.cut = {server.git("rev-parse", tree).strip() for tree in cut}
    text = pin(OWNER, server.commit, FOLDER, address=server.address)
    assert text == server.write_pin().read_text()


@pytest.mark.parametrize(
    ("repository", "folder", "reason"),
    [
        (OWNER, "scene", "has no folder 'scene'; folders at its top: scenes. Did you mean"),
        (OWNER, "scenes/empty", r"no scene.xml; it has a.gltf, b.xml. Name one: .*/a.gltf"),
        (OWNER, "scenes/cellar/none.xml", r"scenes/cellar has no none.xml; it has room.xml"),
        ("wig42/houses", FOLDER, r"GitHub knows no wig42/houses@.*Check the owner"),
    ],
)
def test_a_place_without_a_scene_is_an_error(server, repository, folder, reason):
    with pytest.raises(SceneError, match=reason):
        pin(repository, server.commit, folder, address=server.address)


@pytest.mark.parametrize(
    ("place", "folder", "main"),
    [
        ("scenes/cellar", "scenes/cellar", "room.xml"),  # the only one
        ("scenes/cellar/room.xml", "scenes/cellar", "room.xml"),
        ("scenes/empty/b.xml", "scenes/empty", "b.xml"),
        ("hut.blend", ".", "hut.blend"),  # at the top of the repository
        (".", ".", "hut.blend"),
        (FOLDER, FOLDER, "scene.xml"),
    ],
)
def test_a_pin_names_any_file_of_a_scene(server, tmp_path, place, folder, main):
    text = pin(OWNER, server.commit, place, address=server.address)
    (tmp_path / "a.tsv").write_text(text)
    found = read_pin(tmp_path / "a.tsv")
    assert (found.folder, found.main) == (folder, main)
    assert main in {file.path for file in found.files}
    assert format_pin(found) == text


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        ("403", r"60 requests an hour. Repeat the command after 22:13 UTC"),
        ("429", r"60 requests an hour"),
        ("500", r"HTTP 500 .*Try again later"),
        ("down", "cannot be reached: .*Is there a network"),
    ],
)
def test_an_api_that_refuses_says_when_to_try_again(server, status, reason):
    server.faults["api"] = status
    address = "http://127.0.0.1:9" if status == "down" else server.address
    with pytest.raises(SceneError, match=reason):
        pin(OWNER, server.commit, FOLDER, address=address)
