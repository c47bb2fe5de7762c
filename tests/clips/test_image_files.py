"""EXR files as others write them: windows, parts, deep images, integers and layers."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rlbench.clips import image_files
from rlbench.clips.image_files import Channels, list_channels, read_exr, read_exr_image
from rlbench.errors import SourceError

H, W = 12, 20
RGB = (("R", "G", "B"),)
DISPLAY = (0, 0, W - 1, H - 1)
KINDS = {
    "scan lines": {"type": OpenEXR.scanlineimage},
    "tiles": {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()},
}


def header(data=DISPLAY, display=DISPLAY, kind="scan lines", compression="ZIP") -> dict:
    windows = {"dataWindow": (data[:2], data[2:]), "displayWindow": (display[:2], display[2:])}
    return KINDS[kind] | windows | {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}


def canvas(window, seed=0, dtype=np.float32) -> np.ndarray:
    """An image [h w] of all pixels of a window; the value of a pixel depends on its place alone."""
    y, x = np.mgrid[window[1] : window[3] + 1, window[0] : window[2] + 1]
    return (100 * seed + 50 + y + x / 32).astype(dtype)


def write_windows(path: Path, data, display, dtype=np.float32, **options) -> Path:
    planes = {c: canvas(data, i, dtype) for i, c in enumerate("RGB")}
    OpenEXR.File(header(data, display, **options), planes).write(str(path))
    return path


def shown(data, display, fill=0.0) -> np.ndarray:
    """What the display window shows, pixel by pixel."""
    image = np.full((display[3] - display[1] + 1, display[2] - display[0] + 1, 3), float(fill))
    for row, column in np.ndindex(*image.shape[:2]):
        x, y = display[0] + column, display[1] + row
        if data[0] <= x <= data[2] and data[1] <= y <= data[3]:
            image[row, column] = [100 * i + 50 + y + x / 32 for i in range(3)]
    return image


WINDOW = st.tuples(*(st.integers(low, low + 12) for low in (-8, -8, -2, -2))).filter(
    lambda window: window[0] <= window[2] and window[1] <= window[3]
)
PACKINGS = st.sampled_from(("NO", "RLE", "ZIPS", "ZIP", "PIZ"))
QUICK = settings(max_examples=100, deadline=None, derandomize=True)


@QUICK
@given(
    WINDOW,
    WINDOW,
    st.sampled_from([np.float16, np.float32]),
    st.sampled_from(sorted(KINDS)),
    PACKINGS,
)
@example((100, 60, 107, 64), (98, 57, 111, 66), np.float16, "tiles", "PIZ")  # far from 0
def test_the_display_window_is_the_image_and_has_a_pixel(
    tmp_path_factory, data, display, dtype, kind, packing
):
    path = tmp_path_factory.getbasetemp() / "w.exr"
    write_windows(path, data, display, dtype, kind=kind, compression=packing)
    expected = shown(data, display, -1).astype(dtype)
    is_empty = expected[..., 0] == -1
    if is_empty.all():
        with pytest.raises(SourceError, match=r"w\.exr has no pixel of its image"):
            read_exr(path, RGB)
        return
    image = read_exr_image(path, Channels(RGB), fill=-1)
    np.testing.assert_array_equal(image.pixels, expected)
    np.testing.assert_array_equal(image.empty[..., 0], is_empty)
    assert image.cut == canvas(data).size - (~is_empty).sum()


@pytest.mark.parametrize("order", [OpenEXR.INCREASING_Y, OpenEXR.DECREASING_Y])
def test_the_order_of_scan_lines_does_not_matter(tmp_path, order):
    options = header((2, 1, 9, 30), DISPLAY) | {"lineOrder": order}
    planes = {c: canvas((2, 1, 9, 30), i) for i, c in enumerate("RGB")}
    OpenEXR.File(options, planes).write(str(tmp_path / "o.exr"))
    np.testing.assert_array_equal(
        read_exr(tmp_path / "o.exr", RGB), shown((2, 1, 9, 30), DISPLAY).astype(np.float32)
    )


def test_a_huge_display_window_is_refused_before_it_is_filled(tmp_path):
    path = write_windows(tmp_path / "w.exr", (0, 0, 3, 3), (0, 0, 2**20, 2**20))
    with pytest.raises(SourceError, match=f"from 1 to {image_files.MAX_IMAGE_PIXELS} are read"):
        read_exr(path, RGB)


# Parts


def write_parts(path: Path, parts: dict[str, tuple], **options) -> Path:
    """A multi-part file: data windows by name; the k-th name in the alphabet has seed 3 k."""
    seeds = {name: 3 * k for k, name in enumerate(sorted(parts))}
    made = [
        OpenEXR.Part(
            header(data, **options),
            {c: canvas(data, seeds[name] + i) for i, c in enumerate("RGB")},
            name,
        )
        for name, data in parts.items()
    ]
    OpenEXR.File(made).write(str(path))
    return path


@pytest.mark.parametrize("order", permutations(["albedo", "beauty", "ids"]))
def test_parts_of_one_file_have_windows_of_their_own(tmp_path, order):
    windows = {"albedo": (4, 3, 11, 7), "beauty": DISPLAY, "ids": (-3, -3, 5, 5)}
    path = write_parts(tmp_path / "p.exr", {name: windows[name] for name in order})
    for k, (name, data) in enumerate(sorted(windows.items())):
        expected = shown(data, DISPLAY)
        expected[expected != 0] += 300 * k
        np.testing.assert_array_equal(read_exr(path, RGB, name), expected.astype(np.float32))


@pytest.mark.parametrize(("kind", "compression"), [("scan lines", "ZIP"), ("tiles", "ZIPS")])
@pytest.mark.parametrize("damaged", ["albedo", "beauty", "ids"])
def test_a_damaged_part_is_named_and_the_others_are_read(tmp_path, damaged, kind, compression):
    names = ("albedo", "beauty", "ids")
    path = write_parts(
        tmp_path / "p.exr", dict.fromkeys(names, DISPLAY), kind=kind, compression=compression
    )
    content = bytearray(path.read_bytes())
    start = content.index(b"\0" * 2, content.rindex(b"screenWindowWidth"))
    size = (len(content) - start) // 3  # of a part, as all are alike
    middle = start + size * names.index(damaged) + size // 2
    content[middle - 60 : middle + 60] = bytes(120)
    path.write_bytes(content)
    for k, name in enumerate(names):
        if name == damaged:
            with pytest.raises(SourceError, match=f"p.exr .*part '{name}' is damaged"):
                read_exr(path, RGB, name)
        else:
            expected = shown(DISPLAY, DISPLAY) + 300 * k
            np.testing.assert_array_equal(read_exr(path, RGB, name), expected.astype(np.float32))


def test_a_part_that_is_unfinished_or_not_there_is_named(tmp_path):
    path = write_parts(tmp_path / "p.exr", dict.fromkeys(("a", "b"), DISPLAY))
    path.write_bytes(path.read_bytes()[:-200])
    assert read_exr(path, RGB, "a").shape == (H, W, 3)
    with pytest.raises(SourceError, match="part 'b' is damaged or unfinished"):
        read_exr(path, RGB, "b")
    with pytest.raises(SourceError, match="expected channels R, G, B in the part 'beauty'"):
        read_exr(path, RGB, "beauty")


# Deep images


def deep_part() -> tuple[dict, dict]:
    samples = np.empty((H, W), object)
    for place in np.ndindex(H, W):
        samples[place] = np.ones(sum(place) % 3, np.float32)
    return {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}, {"R": samples}


@pytest.mark.parametrize("read", [lambda path: read_exr(path, RGB), list_channels])
@pytest.mark.parametrize("has_parts", [False, True])
def test_a_deep_image_is_called_so_before_its_channels_are_compared(tmp_path, read, has_parts):
    path = tmp_path / "deep.exr"
    parts = [OpenEXR.Part(*deep_part(), name) for name in ("a", "b")]
    (OpenEXR.File(parts) if has_parts else OpenEXR.File(*deep_part())).write(str(path))
    with pytest.raises(SourceError, match=r"deep\.exr is a deep image; flatten it first$"):
        read(path)


def test_a_flat_part_beside_a_deep_one_is_read(tmp_path):
    flat = OpenEXR.Part(header(), {c: canvas(DISPLAY, i) for i, c in enumerate("RGB")}, "flat")
    OpenEXR.File([OpenEXR.Part(*deep_part(), "deep"), flat]).write(str(tmp_path / "m.exr"))
    image = read_exr(tmp_path / "m.exr", (("R",),))
    np.testing.assert_array_equal(image[..., 0], canvas(DISPLAY))
    with pytest.raises(SourceError, match="deep image; flatten"):
        read_exr(tmp_path / "m.exr", (("R",),), "deep")


# Integers, and channels without a value in every pixel


def test_integers_are_read_exactly(tmp_path):
    ids = np.arange(H * W, dtype=np.uint32).reshape(H, W) * 17_000_000
    parts = [OpenEXR.Part(header(), {"Z": ids}, "ids"), OpenEXR.Part(header(), {"Y": ids}, "b")]
    for file in (OpenEXR.File(parts), OpenEXR.File(header(), {"Z": ids})):
        file.write(str(tmp_path / "i.exr"))
        image = read_exr(tmp_path / "i.exr", (("*.Z",),))
        np.testing.assert_array_equal(image[..., 0], ids.astype(np.float64))
        assert image.dtype == np.float64


# Layers of Blender


def write_layers(path: Path, *layers: str, parts: bool = False) -> Path:
    """One file; the k-th layer has the value k everywhere."""
    planes = {
        layer: {f"{layer}.Combined.{c}": np.full((H, W), k, np.float32) for c in "RGB"}
        for k, layer in enumerate(layers)
    }
    if parts:
        made = [OpenEXR.Part(header(), channels, name) for name, channels in planes.items()]
        OpenEXR.File(made).write(str(path))
    else:
        channels = {name: plane for each in planes.values() for name, plane in each.items()}
        OpenEXR.File(header(), channels).write(str(path))
    return path


COMBINED = (tuple(f"*.Combined.{c}" for c in "RGB"),)


def read_layer(path: Path, layer: str = "") -> float:
    (value,) = np.unique(read_exr_image(path, Channels(COMBINED, "", layer)).pixels)
    return float(value)


@pytest.mark.parametrize("parts", [False, True])
def test_a_layer_is_preferred_to_the_composite(tmp_path, parts):
    path = write_layers(tmp_path / "l.exr", "Composite", "ViewLayer", parts=parts)
    assert read_layer(path) == 1
    assert read_layer(path, "Composite") == 0
    assert read_layer(write_layers(tmp_path / "c.exr", "Composite", parts=parts)) == 0


@pytest.mark.parametrize("parts", [False, True])
def test_one_of_several_layers_is_read_by_its_name(tmp_path, parts):
    path = write_layers(tmp_path / "l.exr", "Near", "Near.001", "Sky", parts=parts)
    for value, layer in enumerate(("Near", "Near.001", "Sky")):
        assert read_layer(path, layer) == value
    path = write_layers(tmp_path / "l.exr", "Near.001", "Sky")
    with pytest.raises(SourceError, match="matches several channels.*--layer 'Near.001'"):
        read_layer(path)
