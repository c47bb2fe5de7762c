"""The command images, on a small clip."""

from __future__ import annotations

from tests.cli.runner import rlbench


def test_images_prints_its_sheets_and_the_methods_they_lack(clip_folder, tmp_path):
    words = ("images", "-m", "mean,eaw", "--clips", clip_folder, "--spp", 0.5, "--out", tmp_path)
    output = rlbench(*words)
    assert f"{tmp_path}/noise-0.5spp-02.png" in output
    assert "noise-0.5spp-02.png lacks eaw: supports 1 to 8 spp" in output


def test_images_writes_the_requested_frame(clip_folder, tmp_path):
    words = ("images", "-m", "mean", "--clips", clip_folder, "--frame", 1, "--out", tmp_path)
    assert f"{tmp_path}/noise-1spp-01.png" in rlbench(*words)
    assert (tmp_path / "noise-1spp-01.png").stat().st_size > 0


def test_images_needs_methods(clip_folder):
    assert "Missing option '--methods'" in rlbench("images", "--clips", clip_folder, code=2)
