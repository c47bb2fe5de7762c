"""A page of image files, opened in a real browser, and how the files are read."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from rlbench.apps.view.gallery import read_gallery
from rlbench.apps.view.viewer import write_gallery
from rlbench.clips.exr import write_exr
from rlbench.clips.linear_images import LooseImageError, read_linear
from rlbench.clips.pfm import write_pfm
from tests.apps.view.viewer.test_browser_images import COLOUR, srgb

SIDE = 40


def write_rgb(file, planes):
    write_exr(file, dict(zip("RGB", planes, strict=True)))


def smooth(seed):
    """A smooth image [3 h w] of linear radiance, up to 1.5."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    waves = [a + b * x + c * y for a, b, c in rng.random((3, 3)) / 2]
    return np.stack(waves).astype(np.float32)


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Linear radiance of a.exr, b.pfm and c.png, by the path of the file."""
    folder = tmp_path_factory.mktemp("gallery")
    planes = {folder / name: smooth(seed) for seed, name in enumerate(("a.exr", "b.pfm", "c.png"))}
    first, second, third = planes
    planes[first][:, 3, 4] = np.nan
    write_rgb(first, planes[first])
    write_pfm(second, planes[second].transpose(1, 2, 0))
    shown = np.rint(255 * srgb(planes[third])).astype(np.uint8).transpose(1, 2, 0)
    alpha = np.full((SIDE, SIDE, 1), 128, np.uint8)
    Image.fromarray(np.concatenate([shown, alpha], axis=-1)).save(third)
    return planes


@pytest.fixture(scope="module")
def gallery(images):
    """The page."""
    file = next(iter(images)).parent / "gallery.html"
    shown, remarks = read_gallery(list(images))
    write_gallery(shown, file, remarks)
    return file


@pytest.fixture
def open_gallery(open_page, gallery):
    """Opens the page of image files at a hash."""
    return lambda place="": open_page(place, file=gallery)


def shows(screen, planes, x, y, pane=0):
    np.testing.assert_allclose(screen.pixel(x, y, SIDE, pane), srgb(planes[:, y, x]), atol=COLOUR)


def test_a_key_shows_each_file_in_place_and_g_all_of_them(open_gallery, images):
    screen = open_gallery()
    numbered = dict(zip("123", images.items(), strict=True))
    for key in "231":
        file, planes = numbered[key]
        screen.press(key)
        assert screen.panes()[0]["label"] == file.name
        shows(screen, planes, 20, 30)
    screen.press("g")
    assert [box["label"] for box in screen.panes()] == [file.name for file in images]
    for pane, planes in enumerate(images.values()):
        shows(screen, planes, 10, 20, pane)


def test_a_pixel_lists_the_values_of_all_files_and_what_is_not_finite_is_magenta(
    open_gallery, images
):
    screen = open_gallery("view=flip&px=20&py=30")
    screen.page.wait_for_selector(".readout table")
    for file, planes in images.items():
        cells = screen.page.locator(f".readout [data-row='{file.name}'] td").all_inner_texts()
        np.testing.assert_allclose([float(c) for c in cells[:3]], planes[:, 30, 20], rtol=0.02)
    np.testing.assert_allclose(screen.pixel(4, 3, SIDE), [1, 0, 1], atol=COLOUR)
    assert "a.exr: pixels that are NaN or infinite" in screen.text("#remarks")


def test_differences_are_those_to_image_a(open_gallery, images):
    screen = open_gallery("view=layers&layer=signed&range=1")
    (_, a), (_, b), (_, c) = images.items()
    for key, base, others in (("1", a, (b, c)), ("3", c, (a, b))):
        screen.press(key)
        for pane, other in enumerate(others):
            error = (srgb(other[:, 30, 20]) - srgb(base[:, 30, 20])).mean()
            expected = mpl.colormaps["RdBu_r"](np.rint((error / 2 + 0.5) * 255) / 255)[:3]
            np.testing.assert_allclose(screen.pixel(20, 30, SIDE, pane), expected, atol=0.02)
    assert "image minus c.png" in screen.text(".legend")


def test_flip_is_that_of_the_chosen_file(open_gallery):
    screen = open_gallery("view=layers&layer=flip")
    labels = [box["label"] for box in screen.panes()]
    assert labels == ["b.pfm", "c.png"]
    screen.page.get_by_label("compared with").select_option("b.pfm")
    screen.settle()
    assert [box["label"] for box in screen.panes()] == ["a.exr", "c.png"]


def test_keys_of_results_do_nothing(open_gallery):
    screen = open_gallery("view=flip")
    before = screen.state
    for key in "dbtrpx.":
        screen.press(key)
        assert screen.state == before


def test_an_address_of_a_page_of_results_shows_the_images(open_gallery, images):
    screen = open_gallery("view=table&show=ref&a=ours&layer=counts")
    assert screen.state["view"] == "flip"
    assert screen.panes()[0]["label"] == next(iter(images)).name


def test_one_file_is_shown_alone(open_page, images, tmp_path):
    shown, _ = read_gallery([next(iter(images))])
    write_gallery(shown, tmp_path / "one.html")
    screen = open_page("view=layers&layer=signed", file=tmp_path / "one.html")
    assert screen.page.locator("option").all_inner_texts().count("image") == 1
    screen.press("f")
    assert screen.page.locator(".methods button").count() == 1


def test_grey_images_and_layers_are_read(tmp_path):
    planes = smooth(0)
    names = dict(zip(("V.Combined.R", "V.Combined.G", "V.Combined.B"), planes, strict=True))
    write_exr(tmp_path / "layers.exr", {**names, **{f"V.Albedo.{c}": planes[0] for c in "RGB"}})
    write_exr(tmp_path / "grey.exr", {"Y": planes[0]})
    shown, _ = read_gallery([tmp_path / "layers.exr", tmp_path / "grey.exr"])
    np.testing.assert_array_equal(shown.images[0].frames[0], planes)
    np.testing.assert_array_equal(shown.images[1].frames[0], np.stack([planes[0]] * 3))
    combined = read_linear(tmp_path / "layers.exr").transpose(2, 0, 1)  # as rlbench score reads it
    np.testing.assert_array_equal(combined, planes)
    (albedo,) = read_gallery([tmp_path / "layers.exr"], layer="V.Albedo")[0].images
    np.testing.assert_array_equal(albedo.frames[0], np.stack([planes[0]] * 3))


SPOILED = {  # what the error says -> the second file, and what writes it
    "cannot be decoded": ("bad.exr", lambda file: file.write_bytes(b"v/1")),
    "16 x 16": ("bad.exr", lambda file: write_rgb(file, smooth(1)[:, :16, :16])),
    "none of .exr": ("bad.gif", lambda file: file.write_bytes(b"GIF89a")),
    "named twice": ("good.exr", lambda file: None),
}


@pytest.mark.parametrize("message", SPOILED)
def test_files_that_cannot_be_shown_are_errors_that_name_them(message, tmp_path):
    name, write = SPOILED[message]
    files = [tmp_path / "good.exr", tmp_path / name]
    write_rgb(files[0], smooth(0))
    write(files[1])
    with pytest.raises(LooseImageError, match=message) as raised:
        read_gallery(files)
    assert str(files[1]) in str(raised.value)
