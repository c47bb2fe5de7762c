"""The commands images, video and view, on a small clip."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from rlbench.clips.exr import write_exr
from tests.cli.runner import rlbench
from tests.conftest import write_plugin


def test_images_writes_the_requested_frame_and_prints_its_sheet_and_what_it_lacks(
    clip_folder, tmp_path
):
    words = ("images", "-m", "mean,eaw", "--clips", clip_folder, "--spp", 0.5, "--frame", 1)
    output = rlbench(*words, "--out", tmp_path)
    assert f"{tmp_path}/noise-0.5spp-01.png" in output
    assert "noise-0.5spp-01.png lacks eaw: supports 1 to 8 spp" in output
    assert (tmp_path / "noise-0.5spp-01.png").stat().st_size > 0


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
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"street-mini-1spp-02", "street-mini-1spp-02.png"}


def test_images_are_not_written_through_a_link(clip_folder, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "noise-1spp-02").symlink_to(tmp_path / "elsewhere")
    words = ("images", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "out")
    assert "noise-1spp-02 is a link, to" in rlbench(*words, code=2)
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_video_writes_one_file_for_each_budget_and_prints_its_name(image_results, image_run):
    words = ("--clips", image_run / "clips", "--spp", "1,2", "--no-labels", "--zoom", 3)
    output = rlbench("video", image_results, "-m", "eaw,mean", *words)
    for spp in (1, 2):
        file = image_results / "video" / f"noise-{spp}spp-eaw-mean.webp"
        assert str(file) in output
        with Image.open(file) as image:
            assert image.size == (2 * 3 * 24 + 4, 3 * 20)


def test_video_without_names_shows_all_rows_with_the_best_last(image_results, image_run, tmp_path):
    out = tmp_path / "videos"
    rlbench("video", image_results, "--clips", image_run / "clips", "--reference", "--out", out)
    assert [file.name for file in out.iterdir()] == ["noise-1spp-mean-eaw-reference.webp"]


def test_video_without_images_names_the_cells_and_a_command_that_makes_them(
    plain_results, image_run
):
    output = rlbench("video", plain_results, "-m", "eaw", "--spp", "1,2", code=2)
    assert "no images of eaw on noise at 1 spp; eaw on noise at 2 spp" in output
    command = output.partition(": rlbench ")[2].split()
    clips = str(image_run / "clips")
    rlbench(*[clips if word == "FOLDER" else word for word in command])
    assert "noise-1spp-eaw.webp" in rlbench("video", plain_results, "-m", "eaw", "--clips", clips)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-m", "mean", "--spp", 8), "no images of mean on noise at 8 spp"),
        (("-m", "svgf"), "no rows of svgf; available: eaw, mean"),
        (("--crop", "0,0,64"), "is not a part of a frame. Give X,Y,WIDTH,HEIGHT"),
        (("--layout", "wipe", "-m", "mean"), "a wipe shows two images"),
        (("--format", "webp,gif"), "--format gif: no such format; use mp4, webp"),
    ],
)
def test_wrong_options_of_video_are_errors_before_anything_is_written(
    image_results, words, message
):
    assert message in rlbench("video", image_results, *words, code=2)
    assert not (image_results / "video").exists()


@pytest.mark.parametrize(
    ("words", "spp", "other"), [((), "1.0", "2.0"), (("--spp", 2), "2.0", "1.0")]
)
def test_view_writes_a_page_with_images_of_the_budget_nearest_to_1_spp_or_of_those_named(
    image_results, image_run, words, spp, other
):
    output = rlbench("view", image_results, "--clips", image_run / "clips", *words)
    assert output == f"{image_results}/report.html"
    page = (image_results / "report.html").read_text()
    assert f'"method":"mean","spp":{spp},"frames":[{{"shape":[3,20,24]' in page
    assert f'"spp":{other},"frames"' not in page


def test_view_without_images_says_what_the_page_has(plain_results):
    output = rlbench("view", plain_results)
    assert "the page has decision and table alone: the results keep no images" in output


def test_view_says_what_to_change(image_results, image_run, tmp_path):
    assert "name the folder with --clips" in rlbench("view", image_results)
    words = ("view", image_results, "--clips", image_run / "clips")
    assert "allow a larger page with --max-mb" in rlbench(*words, "--max-mb", 0.05, code=2)
    assert "no images at 8 spp; the results keep 1, 2" in rlbench(*words, "--spp", 8, code=2)
    assert "no results in" in rlbench("view", tmp_path, code=2)


@pytest.fixture
def image_files(tmp_path, monkeypatch):
    """Two EXR files of one size, in the current folder."""
    monkeypatch.chdir(tmp_path)
    files = [tmp_path / "a.exr", tmp_path / "b.exr"]
    for value, file in enumerate(files):
        write_exr(file, dict.fromkeys("RGB", np.full((20, 24), value / 2, np.float32)))
    return files


def test_view_of_image_files_writes_a_page_of_them(image_files, tmp_path):
    assert rlbench("view", "a.exr", "b.exr", "-q").endswith("gallery.html")
    page = (tmp_path / "gallery.html").read_text()
    assert page.count('"frames":[{"shape":[3,20,24]') == 2
    rlbench("view", image_files[0], "--out", tmp_path / "one.html")
    assert (tmp_path / "one.html").read_text().count('"frames":[{"shape"') == 1


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["folder", "a.exr"], "folder is a folder, and 2 paths are given"),
        (["a.exr", "missing.exr"], "missing.exr"),
        (["a.exr", "b.exr", "--spp", "1"], "--spp is for results"),
        (["a.exr", "--max-mb", "0.05"], "larger page with --max-mb"),
        (["folder", "--layer", "V"], "--layer V is for image files"),
    ],
)
@pytest.mark.usefixtures("image_files")
def test_view_of_what_it_cannot_show_together_says_what_it_shows(tmp_path, words, found):
    (tmp_path / "folder").mkdir()
    assert found in rlbench("view", *words, code=2)
    assert not (tmp_path / "gallery.html").exists()
