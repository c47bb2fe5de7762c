"""Rooms by Infinigen: names, resuming, and errors; a script stands in for Infinigen's process."""

import pytest

from rlbench.errors import OptionError
from rlbench.render.cycles import infinigen_rooms
from rlbench.render.cycles.infinigen_rooms import InfinigenError, Room

WRITES = """
while [ "$1" != --output_folder ]; do shift; done
mkdir -p "$2" && echo room > "$2/scene.blend"
"""


@pytest.fixture
def room(tmp_path):
    return Room("Kitchen", 2, tmp_path / "rooms")


@pytest.fixture
def python(tmp_path):
    """An environment whose Python is a script."""

    def install(body):
        environment = tmp_path / "infinigen"
        (environment / "lib/python3.11/site-packages").mkdir(parents=True, exist_ok=True)
        (environment / "installed.txt").write_text(infinigen_rooms.INFINIGEN)
        script = environment / "bin" / "python"
        script.parent.mkdir(exist_ok=True)
        script.write_text(f"#!/bin/sh\n{body}\n")
        script.chmod(0o755)
        return script

    return install


@pytest.mark.parametrize("text", ["Kitchen", "Kitchen:", "Kitchen:-1", "Kitchen:x", "Attic:1", ""])
def test_what_is_no_room_is_an_error_that_shows_one(text, tmp_path):
    with pytest.raises(OptionError, match="Write Kind:seed, such as Kitchen:2"):
        infinigen_rooms.parse_rooms(text, tmp_path)


def test_the_command_names_the_seed_and_the_kind(room, tmp_path):
    command = infinigen_rooms.generation_command(tmp_path / "python", room, tmp_path / "out")
    assert command[command.index("--seed") + 1] == "2"
    assert command[-1] == 'restrict_solving.restrict_parent_rooms=["Kitchen"]'


def test_a_generated_scene_is_named_after_its_room(room, python):
    file = infinigen_rooms.generate_room(python(WRITES), room)
    assert (file.name, file.read_text()) == ("kitchen-2.blend", "room\n")
    assert not (room.folder / "unfinished").exists()


def test_a_finished_room_is_not_generated_again(room, python, tmp_path):
    file = infinigen_rooms.generate_room(python(WRITES), room)
    assert infinigen_rooms.generate_room(tmp_path / "nowhere", room) == file


def test_a_killed_generation_begins_again(room, python):
    with pytest.raises(InfinigenError, match="exit code -9"):
        infinigen_rooms.generate_room(python(f"{WRITES}touch $2/half; kill -9 $$"), room)
    assert not room.blend.exists()
    empty = f"[ ! -e {room.folder}/unfinished/half ] || exit 1\n{WRITES}"
    assert infinigen_rooms.generate_room(python(empty), room).is_file()


def test_the_error_of_a_failed_generation_has_the_end_of_its_log(room, python):
    with pytest.raises(InfinigenError, match=r"(?s)exit code 3.*generate.log.*no Beams"):
        infinigen_rooms.generate_room(python("echo no Beams >&2; exit 3"), room)


def test_a_generation_without_a_scene_is_an_error(room, python):
    with pytest.raises(InfinigenError, match="wrote no .*scene.blend"):
        infinigen_rooms.generate_room(python("exit 0"), room)


def test_an_installed_environment_is_kept(tmp_path):
    folder = tmp_path / "infinigen"
    folder.mkdir()
    (folder / "installed.txt").write_text("infinigen==1")
    python = infinigen_rooms.ensure_environment(folder, "infinigen==1")
    assert [file.name for file in folder.iterdir()] == ["installed.txt"]
    assert python == folder / "bin" / "python"


@pytest.mark.slow
def test_the_error_of_pip_has_the_end_of_its_log(tmp_path):
    folder = tmp_path / "environment"
    with pytest.raises(
        InfinigenError, match=r"(?s)pip install \./nothing.*environment.log:.*nothing"
    ):
        infinigen_rooms.ensure_environment(folder, "./nothing")
    assert not (folder / "installed.txt").exists()


def test_one_failed_room_does_not_stop_the_others(tmp_path, python, capsys):
    python(f'case "$*" in *Kitchen*) exit 1;; esac\n{WRITES}')
    with pytest.raises(SystemExit, match="1 of 2 rooms failed: kitchen-1"):
        infinigen_rooms.main([str(tmp_path), "--rooms", "Kitchen:1,Bedroom:2", "--rooms-only"])
    assert (tmp_path / "bedroom-2" / "bedroom-2.blend").is_file()
    assert "error: kitchen-1: " in capsys.readouterr().out
