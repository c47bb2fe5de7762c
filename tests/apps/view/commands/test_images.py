"""The command images, on a small clip."""

from __future__ import annotations

import errno

import pytest

from rlbench.system import paths
from tests.cli.runner import rlbench
from tests.conftest import write_plugin


def test_images_prints_its_sheets_and_the_methods_they_lack(clip_folder, tmp_path):
    words = ("images", "-m", "mean,eaw", "--clips", clip_folder, "--spp", 0.5, "--out", tmp_path)
    output = rlbench(*words)
    assert f"{tmp_path}/noise-0.5spp-02.png" in output
    assert "noise-0.5spp-02.png lacks eaw: supports 1 to 8 spp" in output


def test_images_writes_the_requested_frame(clip_folder, tmp_path):
    words = ("images", "-m", "mean", "--clips", clip_folder, "--frame", 1, "--out", tmp_path)
    assert f"{tmp_path}/noise-1spp-01.png" in rlbench(*words)
    assert (tmp_path / "noise-1spp-01.png").stat().st_size > 0


def test_images_names_what_is_not_finite(clip_folder, tmp_path):
    body = "return samples.mean * float('nan'), None"
    plugin = write_plugin(tmp_path / "odd.py", "odd", body=body)
    words = ("images", "-m", "odd", "--plugin", plugin, "--clips", clip_folder)
    output = rlbench(*words, "--out", tmp_path / "o")
    assert "480 pixels of odd, drawn in magenta, are NaN or infinite" in output


def test_images_of_methods_that_support_no_budget_are_an_error(clip_folder, tmp_path):
    words = ("images", "-m", "eaw", "--clips", clip_folder, "--spp", "0.5,0.6", "--out", tmp_path)
    output = rlbench(*words, code=2)
    assert "error: eaw: supports 1 to 8 spp, requested 0.5; eaw: supports 1 to 8" in output


def test_images_needs_methods(clip_folder):
    assert "name methods, for example -m ours,mean" in rlbench(
        "images", "--clips", clip_folder, code=2
    )


def _rename(folder, name):
    header = folder / "clip.toml"
    header.write_text(header.read_text().replace('name = "noise"', f'name = "{name}"'))


@pytest.mark.parametrize("name", ["../../escape", "/escape", "..", "a/../../escape"])
def test_a_name_that_leads_out_of_the_folder_is_refused(clip_folder, tmp_path, name):
    _rename(clip_folder, name)
    before = sorted(tmp_path.rglob("*"))
    words = ("images", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "a" / "b")
    assert "expected letters, digits and" in rlbench(*words, code=2)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_name_of_two_parts_gives_files_directly_in_the_folder(clip_folder, tmp_path):
    _rename(clip_folder, "street/mini")
    rlbench("images", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "street-mini-1spp-02",
        "street-mini-1spp-02.png",
    }


def test_images_are_not_written_through_a_link(clip_folder, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "noise-1spp-02").symlink_to(tmp_path / "elsewhere")
    words = ("images", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "out")
    assert "noise-1spp-02 is a link, to" in rlbench(*words, code=2)
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_full_disk_is_one_line_and_leaves_no_partial_image(clip_folder, tmp_path, monkeypatch):
    def fail(path):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(paths, "_synchronize", fail)
    words = ("images", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "out")
    output = rlbench(*words, code=2)
    assert "No space left on device" in output
    assert "bytes free" in output
    assert [path for path in (tmp_path / "out").rglob("*") if path.is_file()] == []
