"""Downloads of scenes from a server on this machine: what is verified, kept, copied and refused."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rlbench.apps.render.scenes.collection.catalog import locate
from rlbench.apps.render.scenes.collection.download import (
    DownloadError,
    Fetched,
    UnreachableError,
    get,
)
from rlbench.system import paths
from tests.scene_server import FILES, SceneServer, found_files

MESH = "models/Mesh000.obj"


@pytest.fixture
def target() -> Path:
    return paths.scenes_folder() / "attic"


def fetch(server: SceneServer, **options: object) -> Fetched:
    return get("attic", address=server.address, pause_s=0.0, **options)


def scene_files(folder: Path) -> dict[str, bytes]:
    """The files of a folder, apart from the credit."""
    return {path: content for path, content in found_files(folder).items() if path != "CREDITS.md"}


def test_a_scene_is_downloaded_to_where_it_is_located(server, target):
    reported = []
    fetched = fetch(server, on_progress=lambda file: reported.append(file.path))
    assert fetched == Fetched(target, downloaded=4, copied=0, kept=0)
    assert sorted(reported) == sorted(FILES)
    assert scene_files(target) == FILES
    assert locate("attic").missing == ()
    assert "github.com/wig42/rooms/tree" in (target / "CREDITS.md").read_text()


def test_a_file_is_downloaded_again_only_where_it_was_changed(server, target):
    fetch(server)
    assert fetch(server).kept == 4
    assert set(server.requests.values()) == {1}
    (target / MESH).write_bytes(FILES[MESH][::-1])
    assert fetch(server).downloaded == 1
    assert scene_files(target) == FILES


def test_files_of_the_mirror_are_copied_and_the_others_downloaded(
    server, target, tmp_path, monkeypatch
):
    for path in ("scene.xml", MESH):
        (tmp_path / "mirror" / "attic" / path).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / "mirror" / "attic" / "scene.xml").write_bytes(FILES["scene.xml"])
    (tmp_path / "mirror" / "attic" / MESH).write_bytes(FILES[MESH][::-1])  # not the pinned content
    monkeypatch.setenv("RLBENCH_SCENES", str(tmp_path / "mirror"))
    assert fetch(server) == Fetched(target, downloaded=3, copied=1, kept=0)
    assert server.requests["scene.xml"] == 0
    assert scene_files(target) == FILES


@pytest.mark.parametrize("fault", ["truncated once", "wrong once", "silent once", "503 once"])
def test_a_passing_fault_is_tried_again(server, target, fault):
    server.faults[MESH] = fault
    fetch(server)
    assert scene_files(target) == FILES
    assert server.requests[MESH] == 2


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("truncated", f"160000 of {len(FILES[MESH])} bytes came"),
        ("wrong", f"{len(FILES[MESH])} bytes of git blob id .* came, expected"),
        ("silent", "no answer from"),
        ("503", "the server failed (HTTP 503"),
    ],
)
def test_a_lasting_fault_costs_its_file_alone_after_three_tries(server, target, fault, reason):
    server.faults[MESH] = fault
    with pytest.raises(DownloadError, match=f"{MESH}: {re.escape(reason)}".replace(r"\.\*", ".*")):
        fetch(server)
    assert server.requests[MESH] == 3
    assert scene_files(target) == {k: v for k, v in FILES.items() if k != MESH}
    assert (target / "CREDITS.md").exists()


def test_a_truncated_file_of_unknown_size_is_noticed_by_its_hash(server, target):
    server.write_pin(without_sizes=True)
    server.faults[MESH] = "truncated"
    with pytest.raises(DownloadError, match="160000 bytes of git blob id"):
        fetch(server)
    assert not (target / MESH).exists()


def test_a_file_that_is_gone_is_not_tried_again_and_the_next_download_continues(server, target):
    server.faults[MESH] = "404"
    with pytest.raises(DownloadError, match="the file is gone at that commit .HTTP 404") as error:
        fetch(server)
    expected = "1 of 4 files of attic cannot be downloaded.*3 of 4 .* kept. Repeat the command, or"
    assert re.search(expected, str(error.value), re.DOTALL)
    assert server.requests[MESH] == 1
    server.faults.clear()
    assert fetch(server) == Fetched(target, downloaded=1, copied=0, kept=3)


def test_a_server_that_is_down_is_one_error_and_lets_the_mirror_be_copied(
    server, target, tmp_path, monkeypatch
):
    with pytest.raises(UnreachableError, match="0 of 4 files") as error:
        get("attic", address="http://127.0.0.1:9", pause_s=0.0)
    assert str(error.value).count("cannot be reached") == 1
    assert not target.exists()
    mirror = tmp_path / "mirror" / "attic"
    mirror.mkdir(parents=True)
    (mirror / "scene.xml").write_bytes(FILES["scene.xml"])
    monkeypatch.setenv("RLBENCH_SCENES", str(mirror.parent))
    with pytest.raises(UnreachableError, match="1 of 4 files"):
        get("attic", address="http://127.0.0.1:9", pause_s=0.0)
    assert scene_files(target) == {"scene.xml": FILES["scene.xml"]}


@pytest.mark.parametrize("status", ["403", "429"])
def test_a_server_that_refuses_is_one_error(server, target, status):
    server.faults["all"] = status
    with pytest.raises(UnreachableError, match=f"the server refuses .*HTTP {status}"):
        fetch(server)


def test_ctrl_c_leaves_nothing_half_written(server, target):
    server.faults[MESH] = "trickle"

    def interrupt(file: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fetch(server, on_progress=interrupt)
    found = scene_files(target)
    assert MESH not in found
    assert found.items() <= FILES.items()


def test_a_download_continues_after_a_kill_and_removes_what_it_left(server, target):
    server.faults[MESH] = "stall"
    call = f"get('attic', address={server.address!r})"
    code = f"from rlbench.apps.render.scenes.collection.download import get; {call}"
    process = subprocess.Popen([sys.executable, "-c", code])
    others = {Path(path).name for path in FILES} - {Path(MESH).name}
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        names = {path.name for path in target.rglob("*")}
        if others <= names and any(name.endswith(".Mesh000.obj") for name in names):
            break
        time.sleep(0.02)
    process.kill()
    process.wait()
    (unfinished,) = (path for path in scene_files(target) if re.search(r"\.[0-9a-f]{32}\.", path))
    assert unfinished.startswith("models/")
    server.faults.clear()
    assert fetch(server).downloaded == 1
    assert scene_files(target) == FILES
