"""The commands pack and download, with a web server on this machine as the mirror."""

from __future__ import annotations

import functools
import http.server
import shutil
import threading

import pytest
import tomli_w

from rlbench.clips.archive import clip_digests
from rlbench.clips.stored import verify
from rlbench.system import documents, paths
from tests.cli.runner import rlbench
from tests.conftest import write_noise


@pytest.fixture
def mirror(tmp_path):
    """A folder with two clips of preset tiny, packed; the cache is empty again."""
    cache = paths.clips_folder() / "tiny"
    for name in ("temple", "city"):
        write_noise(cache / name, name, preset="tiny")
    output = rlbench("pack", "--preset", "tiny", "--out", tmp_path / "mirror")
    assert "2 clips of tiny" in output
    shutil.rmtree(cache)
    return tmp_path / "mirror"


@pytest.fixture
def address(mirror):
    """The mirror on a web server, and the paths that were asked for."""
    requests = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *words):
            requests.append(self.path)

    handler = functools.partial(Handler, directory=mirror)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}", requests
    server.shutdown()
    server.server_close()


def test_clips_of_a_web_server_are_in_the_cache_where_a_run_finds_them(address):
    url, requests = address
    rlbench("download", "--preset", "tiny", "--mirror", url)
    for name in ("temple", "city"):
        assert verify(paths.clips_folder() / "tiny" / name) == []
    assert requests == ["/clips.toml", "/tiny-city.tar", "/tiny-temple.tar"]
    assert sorted(p.name for p in (paths.clips_folder() / "tiny").iterdir()) == ["city", "temple"]


def test_clips_that_are_there_are_not_downloaded_again(address):
    url, requests = address
    rlbench("download", "--preset", "tiny", "--mirror", url, "--scenes", "city")
    output = rlbench("download", "--preset", "tiny", "--mirror", url)
    assert "city is there already" in output
    assert requests.count("/tiny-city.tar") == 1


def test_a_folder_is_a_mirror_too(mirror, tmp_path):
    rlbench("download", "--preset", "tiny", "--mirror", mirror, "--out", tmp_path / "clips")
    assert verify(tmp_path / "clips" / "city") == []


def test_a_registry_names_mirrors_which_are_tried_in_order(mirror, address, tmp_path):
    url, _ = address
    document = documents.read_toml(mirror / "clips.toml")
    for entry in document["archives"]:
        entry["urls"] = [f"{url}/gone/{entry['file']}", f"{url}/{entry['file']}"]
    (tmp_path / "mine.toml").write_text(tomli_w.dumps(document))
    words = ("--registry", tmp_path / "mine.toml", "--out", tmp_path / "clips")
    rlbench("download", "--preset", "tiny", *words)
    assert clip_digests(tmp_path / "clips" / "city") == document["archives"][0]["digests"]


def test_a_file_with_another_hash_is_refused(mirror, tmp_path):
    with (mirror / "tiny-city.tar").open("r+b") as file:
        file.seek(2000)
        file.write(b"x")
    words = ("--mirror", mirror, "--out", tmp_path / "clips")
    assert "cannot be downloaded: SHA256 hash" in rlbench(
        "download", "--preset", "tiny", *words, code=2
    )
    assert list((tmp_path / "clips").iterdir()) == []


def test_a_registry_cannot_name_a_path(mirror, tmp_path):
    text = (mirror / "clips.toml").read_text()
    (mirror / "clips.toml").write_text(text.replace('clip = "city"', 'clip = "../city"'))
    output = rlbench("download", "--preset", "tiny", "--mirror", mirror, code=2)
    assert "'../city' is no name of a preset, a clip or a file" in output


def test_clips_of_other_pixels_do_not_enter_the_cache_of_a_preset_with_a_baseline(tmp_path):
    write_noise(paths.clips_folder() / "mini" / "city", "city", preset="mini")
    rlbench("pack", "--preset", "mini", "--out", tmp_path / "mirror")
    shutil.rmtree(paths.clips_folder() / "mini")
    output = rlbench("download", "--preset", "mini", "--mirror", tmp_path / "mirror", code=2)
    assert "city of this mirror has other pixels than the clips of the shipped baseline" in output
    rlbench(
        "download", "--preset", "mini", "--mirror", tmp_path / "mirror", "--out", tmp_path / "apart"
    )


def test_without_a_mirror_the_command_that_renders_is_named():
    output = rlbench("download", "--preset", "mini", code=2)
    assert "rendering is the only source: rlbench render --preset mini" in output


def test_a_mirror_that_does_not_answer_and_one_without_the_preset_are_errors(mirror):
    output = rlbench("download", "--preset", "tiny", "--mirror", "http://127.0.0.1:9", code=2)
    assert "http://127.0.0.1:9/clips.toml cannot be downloaded" in output
    output = rlbench("download", "--preset", "paper", "--mirror", mirror, code=2)
    assert "has no clips of paper; it has tiny" in output


def test_a_clip_with_other_pixels_is_not_overwritten(mirror, tmp_path):
    write_noise(tmp_path / "clips" / "city", "city", frames=2)
    words = ("--mirror", mirror, "--out", tmp_path / "clips")
    assert "exists, unfinished or with other pixels" in rlbench(
        "download", "--preset", "tiny", *words, code=2
    )


def test_clips_that_were_not_rendered_cannot_be_packed(tmp_path):
    output = rlbench("pack", "--preset", "tiny", "--out", tmp_path / "mirror", code=2)
    assert "the cache has no clip of tiny. Render them: rlbench render --preset tiny" in output


def test_a_disk_that_fills_up_during_a_download_names_the_option(mirror, small_disk):
    words = ("--preset", "tiny", "--mirror", mirror, "--out", small_disk / "clips")
    output = rlbench("download", *words, code=2)
    assert "cannot be written" in output
    assert output.endswith("--out names another folder")


def test_a_download_that_is_not_possible_makes_no_folder(tmp_path):
    out = tmp_path / "new"
    rlbench("download", "--preset", "tiny", "--mirror", tmp_path / "no", "--out", out, code=2)
    assert not out.exists()


def test_a_clip_with_a_typo_is_answered_with_the_nearest(mirror, tmp_path):
    words = ("--preset", "tiny", "--mirror", mirror, "--out", tmp_path / "clips")
    output = rlbench("download", *words, "--scenes", "cty", code=2)
    assert output.endswith("available: city, temple. Did you mean 'city'?")
    for name in ("temple", "city"):
        write_noise(paths.clips_folder() / "tiny" / name, name, preset="tiny")
    output = rlbench("pack", "--preset", "tiny", "--scenes", "cty", "--out", tmp_path, code=2)
    assert "Did you mean 'city'? To render clips: rlbench render --preset tiny" in output
