"""Files are written whole or not at all, where the variable says, by one process a folder."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from rlbench.errors import RlbenchError
from rlbench.system import paths
from rlbench.system.folder_lock import LOCK_FILE, FolderInUseError, locked_folder
from rlbench.system.paths import WriteError
from rlbench.system.store import claim, read_text, recall

synchronize = paths._synchronize  # which a fixture of all tests replaces


def test_the_cache_lies_where_the_variable_says(tmp_path, monkeypatch):
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path / "elsewhere"))
    assert paths.cache_folder() == tmp_path / "elsewhere"
    assert paths.clips_folder().parent == paths.decoded_folder().parent == paths.cache_folder()
    monkeypatch.setenv("RLBENCH_CACHE", "~/cache")
    assert "~" not in str(paths.cache_folder())
    monkeypatch.delenv("RLBENCH_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert paths.cache_folder().name == "rlbench"


def test_a_file_appears_only_when_it_is_complete(tmp_path):
    path = tmp_path / "folder" / "file.txt"
    with paths.atomic_write(path) as temporary:
        temporary.write_text("new")
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


@contextmanager
def written(path):
    """Text is written to the file, before what the block does."""
    with paths.atomic_write(path) as temporary:
        temporary.write_text("new")
        yield temporary


def test_an_error_leaves_the_old_file_and_no_temporary_one(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), written(path):
        raise ZeroDivisionError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


# On the disk before it has its name


def test_content_reaches_the_disk_before_the_name_and_the_name_before_the_return(
    tmp_path, monkeypatch
):
    path, events = tmp_path / "file.txt", []
    monkeypatch.setattr(paths, "_synchronize", synchronize)
    monkeypatch.setattr(
        os, "fsync", lambda fd: events.append((os.readlink(f"/proc/self/fd/{fd}"), path.exists()))
    )
    with written(path) as temporary:
        pass
    assert events == [(str(temporary), False), (str(tmp_path), True)]


def test_a_cached_file_does_not_wait_for_the_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "_synchronize", None)  # calling it would be an error
    with paths.cache_write(tmp_path / "file.txt") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "file.txt").read_text() == "new"


# Full disks and read-only folders


FULL = OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_one_line_with_folder_free_bytes_and_remedy(tmp_path, monkeypatch):
    message = (
        rf"^.*file\.txt cannot be written \(.*No space left.*\); {tmp_path} has \d+ bytes free"
    )
    with (
        pytest.raises(WriteError, match=message + ", free some space") as caught,
        written(tmp_path / "file.txt"),
    ):
        raise FULL
    assert isinstance(caught.value, RlbenchError)
    assert "\n" not in str(caught.value)
    assert paths.write_remedy(caught.value) == "--out names another folder"
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path))
    assert paths.write_remedy(caught.value) == "the variable RLBENCH_CACHE names another folder"
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_does_not_fit_on_a_synchronized_disk_is_not_renamed(tmp_path, monkeypatch):
    def fail(path):
        raise FULL

    monkeypatch.setattr(paths, "_synchronize", fail)
    with pytest.raises(WriteError), written(tmp_path / "file.txt"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_folder_below_a_file_or_without_permission_or_removed_meanwhile_is_reported(
    tmp_path, monkeypatch
):
    (tmp_path / "file").write_text("old")
    message = "cannot be written .*choose another folder"
    with pytest.raises(WriteError, match=message), written(tmp_path / "file" / "below" / "new"):
        pass
    message = r"a\.txt cannot be written \(its folder .*out was removed"
    with pytest.raises(WriteError, match=message), written(tmp_path / "out" / "a.txt"):
        shutil.rmtree(tmp_path / "out")
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    error = paths.write_error(tmp_path / "file", "Permission denied")
    assert "the folder is not writable: change its permissions" in str(error)


def test_other_errors_of_the_block_are_not_disguised(tmp_path):
    with pytest.raises(FileNotFoundError) as raised, written(tmp_path / "file"):
        (tmp_path / "absent").read_text()
    assert not isinstance(raised.value, WriteError)


# Links


@pytest.mark.parametrize("make", [os.symlink, os.link], ids=["link", "second-name"])
def test_a_file_elsewhere_is_not_appended_to(tmp_path, make):
    (tmp_path / "notes").write_text("precious")
    make(tmp_path / "notes", tmp_path / "log")
    with pytest.raises(WriteError):
        paths.open_to_append(tmp_path / "log")
    assert (tmp_path / "notes").read_text() == "precious"


def test_a_folder_below_results_that_is_a_link_is_refused_and_the_results_may_be_one(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "results").symlink_to("elsewhere")
    inside = tmp_path / "results" / "images"
    assert paths.check_no_link(tmp_path / "results", inside / "a") == inside / "a"
    inside.symlink_to(tmp_path)
    with pytest.raises(WriteError, match="images is a link"):
        paths.check_no_link(tmp_path / "results", inside / "a")


# One writer a folder


OWNER = """
import sys, time
from pathlib import Path
from rlbench.system.folder_lock import locked_folder
with locked_folder(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


def test_a_lock_is_held_once_and_leaves_nothing(tmp_path):
    with locked_folder(tmp_path / "r"):
        who = f"process {os.getpid()} on "
        with pytest.raises(FolderInUseError, match=who), locked_folder(tmp_path / "r"):
            pass
        with locked_folder(tmp_path / "other"):
            pass
    assert list((tmp_path / "r").iterdir()) == []
    with locked_folder(tmp_path / "r"):
        pass


def test_the_lock_of_a_killed_process_is_free(tmp_path):
    owner = subprocess.Popen([sys.executable, "-c", OWNER, tmp_path], stdout=subprocess.PIPE)
    assert owner.stdout is not None
    assert owner.stdout.readline() == b"locked\n"
    with pytest.raises(FolderInUseError, match=f"process {owner.pid} on "), locked_folder(tmp_path):
        pass
    owner.send_signal(signal.SIGKILL)
    owner.wait()
    assert (tmp_path / LOCK_FILE).exists()
    with locked_folder(tmp_path):
        pass
    assert not (tmp_path / LOCK_FILE).exists()


def test_the_next_lock_removes_what_a_killed_process_left_and_nothing_of_a_living_one(tmp_path):
    code = (
        "import os, sys; from pathlib import Path; from rlbench.system import paths\n"
        "with paths.atomic_write(Path(sys.argv[1])) as file: file.touch(); os._exit(1)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "clip" / "a.exr")], check=False)
    assert len(list(tmp_path.rglob(".*.a.exr"))) == 1
    with paths.atomic_write(tmp_path / "clip" / "b.exr") as alive:
        alive.touch()
        with locked_folder(tmp_path):
            assert list(tmp_path.rglob("*.exr")) == [alive]


# Files that say what is done already


@pytest.mark.parametrize(("stored", "is_kept"), [("new", True), ("old", False), (None, False)])
def test_files_stay_where_the_key_beside_them_is_the_one_asked_for(tmp_path, stored, is_kept):
    image, key_file = tmp_path / "0000.exr", tmp_path / "key.txt"
    image.touch()
    if stored:
        key_file.write_text(stored)
    claim(key_file, "new", older=[image, tmp_path / "absent.exr"])
    assert (image.exists(), read_text(key_file)) == (is_kept, "new")


def test_an_answer_is_found_once_for_each_key(tmp_path):
    answers = iter([1.5, 2.5])
    keys = ["a", "b", "a"]
    found = [recall(tmp_path / "answers.json", key, lambda: next(answers)) for key in keys]
    assert found == [1.5, 2.5, 1.5]
