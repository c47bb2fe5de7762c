"""Values that no clip may hold, and windows: what is said, repaired and counted."""

from __future__ import annotations

from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

from rlbench.clips.stored import open_clip, verify
from tests.apps.dumps.exr_files import Planes, write_file
from tests.cli.runner import rlbench

H, W = 16, 24
FRAMES = (1001, 1002, 1003)
LAYOUT = """
[radiance]
files = "s{sample}/b.{frame}.exr"
[reference]
files = "r{half}/b.{frame}.exr"
[albedo]
files = "aov.{frame}.exr"
channels = ["albedo.R", "albedo.G", "albedo.B"]
[normal]
files = "aov.{frame}.exr"
channels = ["normal.X", "normal.Y", "normal.Z"]
[depth]
files = "aov.{frame}.exr"
channels = ["depth.Z"]
[motion]
files = "aov.{frame}.exr"
channels = ["motion.X", "motion.Y"]
"""


def rgb(value: float, prefix: str = "") -> Planes:
    """Constant channels."""
    return {f"{prefix}{c}": np.full((H, W), value, np.float32) for c in "RGB"}


def aovs() -> Planes:
    """Buffers whose values differ from pixel to pixel where a neighbour's would be taken."""
    y, x = np.mgrid[:H, :W].astype(np.float32)
    angle = (x + y) / 100
    return {
        **{f"albedo.{c}": 0.2 + (x + 2 * y) / 100 for c in "RGB"},
        "normal.X": np.cos(angle),
        "normal.Y": np.sin(angle),
        "normal.Z": np.zeros((H, W), np.float32),
        "depth.Z": 2 + x + y / 10,
        "motion.X": 1 + x / 10,
        "motion.Y": -1 + y / 10,
    }


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder with a dump of two samples and two halves, and its layout."""
    for frame in FRAMES:
        for place in ("s0", "s1", "rA", "rB"):
            write(tmp_path, f"{place}/b.{frame}.exr", rgb(0.5))
        write(tmp_path, f"aov.{frame}.exr", aovs())
    (tmp_path / "layout.toml").write_text(LAYOUT)
    return tmp_path


def write(folder: Path, name: str, planes: Planes, **header) -> None:
    write_file(folder / "dump" / name, {"": planes}, **header)


def change_layout(folder: Path, old: str, new: str) -> None:
    (folder / "layout.toml").write_text(LAYOUT.replace(old, new, 1))


def import_dump(folder: Path, *words: object, code: int = 0) -> str:
    """The output of an import of folder/dump to folder/out."""
    fixed = ("import", folder / "dump", "--layout", folder / "layout.toml")
    return rlbench(*fixed, "--out", folder / "out", *words, code=code)


def frame_of(folder: Path, index: int):
    return open_clip(folder / "out" / "dump", seed=0).frame(index)


def pixel(image, row=3, column=5) -> np.ndarray:
    return image[..., row, column].squeeze().numpy()


def break_buffer(folder: Path, name: str, value: float, channels: str) -> None:
    planes = aovs()
    for channel in channels:
        planes[f"{name}.{channel}"][3, 5] = value
    write(folder, "aov.1002.exr", planes)


@pytest.mark.parametrize(("place", "value"), [("s0", nan), ("s1", inf), ("rA", -inf), ("rB", nan)])
def test_radiance_that_is_not_finite_names_file_frame_and_remedy(folder, place, value):
    image = rgb(0.5)
    image["G"][3, 5] = value
    write(folder, f"{place}/b.1002.exr", image)
    output = import_dump(folder, code=2)
    assert f"{place}/b.1002.exr" in output.replace(" ", "")
    assert "in frame 1002 of clip 'dump'" in output
    assert "x 5, y 3" in output
    assert "--exposure" not in output
    repaired = import_dump(folder, "--sanitize")  # the remedy helps
    kind = "radiance" if place[0] == "s" else "reference"
    assert f"1 pixels of {kind} were repaired, first in frame 1002" in repaired
    assert verify(folder / "out" / "dump") == []
    frame = frame_of(folder, 1)
    values = {
        "s": pixel(frame.pool.radiance).min(),
        "rA": pixel(frame.reference.half_a).max(),
        "rB": pixel(frame.reference.half_b).max(),
    }
    assert values["s" if place[0] == "s" else place] == 0  # black, as the core makes it
    assert sum(value == 0 for value in values.values()) == 1


def test_emission_that_is_not_finite_is_named(folder):
    change_layout(folder, "[radiance]", '[emission]\nfiles = "e.{frame}.exr"\n[radiance]')
    for frame in FRAMES:
        write(folder, f"e.{frame}.exr", rgb(nan if frame == 1003 else 0))
    assert "dump/e.1003.exr: " in import_dump(folder, code=2).replace("dump/ ", "dump/")


def test_a_firefly_survives_sanitizing_and_negative_radiance_does_not(folder):
    image = rgb(0.5)
    image["R"][0, 0], image["R"][1, 1] = 3e6, -2
    write(folder, "s0/b.1001.exr", image)
    output = import_dump(folder, "--sanitize", "--exposure", "1")
    assert "1 pixels of radiance were repaired" in output
    radiance = frame_of(folder, 0).pool.radiance
    assert radiance.max() == 3e6
    assert sorted(radiance[0, :, 0, 1, 1].tolist()) == [0, 0.5]


@pytest.mark.parametrize(
    ("encoded", "channels", "value"),
    [("false", "X", nan), ("true", "YZ", inf), ("false", "XYZ", -inf)],
)
def test_normals_that_are_not_finite_are_counted(folder, encoded, channels, value):
    change_layout(folder, "[depth]", f"encoded = {encoded}\n[depth]")
    break_buffer(folder, "normal", value, channels)
    output = import_dump(folder)
    assert "1 pixels of normal are NaN or infinite, and became background, first in frame" in output
    assert (pixel(frame_of(folder, 1).gbuffer.normal) == 0).all()
    assert "--sanitize" in output


@pytest.mark.parametrize(
    ("name", "channels", "value"),
    [("normal", "Y", nan), ("albedo", "RGB", inf), ("motion", "X", -inf), ("depth", "Z", nan)],
)
def test_sanitized_buffers_take_the_value_of_a_neighbour(folder, name, channels, value):
    break_buffer(folder, name, value, channels)
    output = import_dump(folder, "--sanitize")
    assert f"1 pixels of {name} were repaired, first in frame 1002" in output
    buffer = getattr(frame_of(folder, 1).gbuffer, name)
    np.testing.assert_array_equal(pixel(buffer), pixel(buffer, 3, 4))  # to the left
    assert np.isfinite(pixel(buffer)).all()


def test_what_a_sky_has_in_place_of_a_normal_is_no_damage(folder):
    planes = aovs()
    planes["depth.Z"][:5] = inf
    for letter in "XYZ":
        planes[f"normal.{letter}"][:5] = nan
    write(folder, "aov.1002.exr", planes)
    assert "pixels of normal" not in import_dump(folder, "--sanitize")
    assert (frame_of(folder, 1).gbuffer.normal[0, :, :5] == 0).all()


def test_a_correct_dump_is_not_repaired_and_its_layout_may_have_a_byte_order_mark(folder):
    (folder / "layout.toml").write_text(LAYOUT, "utf-8-sig")
    output = import_dump(folder, "--sanitize")
    assert "repaired" not in output
    assert "note:" not in output


# Windows

DISPLAY = ((0, 0), (W - 1, H - 1))
CROP = {"dataWindow": ((3, 2), (19, 8)), "displayWindow": DISPLAY}


def crop(planes: Planes) -> Planes:
    return {name: plane[2:9, 3:20] for name, plane in planes.items()}


def test_a_crop_is_empty_outside_and_counted(folder):
    write(folder, "aov.1002.exr", crop(aovs()), **CROP)
    for place in ("s1", "rA"):
        write(folder, f"{place}/b.1002.exr", crop(rgb(0.5)), **CROP)
    output = import_dump(folder, "--exposure", "1")
    outside = np.ones((H, W), bool)
    outside[2:9, 3:20] = False
    # four buffers, a sample and a half
    count = 6 * outside.sum()
    assert f"6 images do not fill their display window: {count} pixels are empty" in output
    assert "first in frame 1002" in output
    frame, complete = frame_of(folder, 1), frame_of(folder, 0)
    for name, value in {"albedo": 0, "normal": 0, "depth": inf, "motion": 0}.items():
        found = getattr(frame.gbuffer, name)[0].numpy()
        assert (found[:, outside] == value).all()
        expected = getattr(complete.gbuffer, name)[0].numpy()
        np.testing.assert_array_equal(found[:, ~outside], expected[:, ~outside])
    half = np.where(outside, 0, np.float32(0.5))[None].repeat(3, 0)
    np.testing.assert_array_equal(frame.reference.half_a[0].numpy(), half)
    assert sorted(frame.pool.radiance[0, :, 0, 0, 0].tolist()) == [0, 0.5]


@pytest.mark.parametrize(
    ("table", "keys"),
    [
        ("[normal]", "encoded = true"),
        ("[motion]", 'offset = 0.5\nunit = "shares"'),
        ("[depth]", 'kind = "inverse"'),
        ("[motion]", 'points = "to next"'),
    ],
)
def test_what_is_outside_a_crop_is_empty_in_any_convention(folder, table, keys):
    change_layout(folder, table, f"{table}\n{keys}")
    for frame in FRAMES:
        write(folder, f"aov.{frame}.exr", crop(aovs()), **CROP)
    import_dump(folder)
    gbuffer = frame_of(folder, 2).gbuffer
    assert (pixel(gbuffer.motion, -1, 0) == 0).all()
    assert (pixel(gbuffer.normal, -1, 0) == 0).all()
    assert pixel(gbuffer.depth, -1, 0) == inf


def test_overscan_is_cut_and_counted(folder):
    wide = {name: np.pad(plane, 2, mode="edge") for name, plane in rgb(0.25).items()}
    window = {"dataWindow": ((-2, -2), (W + 1, H + 1)), "displayWindow": DISPLAY}
    write(folder, "s0/b.1003.exr", wide, **window)
    pixels = (W + 4) * (H + 4) - W * H
    assert f"1 images have overscan: {pixels} pixels outside the display" in import_dump(folder)


# Samples in one file


def write_samples(folder: Path, numbers: tuple[str, ...], keys: str) -> None:
    """The samples of each frame in layers of one file, or in its parts, as `keys` says."""
    change_layout(folder, '"s{sample}/b.{frame}.exr"', f'"all.{{frame}}.exr"\n{keys}')
    for frame in FRAMES:
        parts: dict[str, Planes] = {}
        for value, number in enumerate(numbers, 1):
            if "part" in keys:
                parts[f"s{number}"] = rgb(value / 8)
            else:
                parts[""] = parts.get("", {}) | rgb(value / 8, f"s{number}.")
        write_file(folder / "dump" / f"all.{frame}.exr", parts)


LAYERS = 'channels = ["s{sample}.R", "s{sample}.G", "s{sample}.B"]'


@pytest.mark.parametrize(
    ("keys", "numbers"),
    [
        (LAYERS, "012"),
        (LAYERS.replace("s{", "*{"), "123"),
        (LAYERS, ("001", "002", "003")),
        ('part = "s{sample}"\nchannels = ["R", "G", "B"]', "123"),
    ],
)
def test_samples_in_one_file_are_numbered_from_any_number(folder, keys, numbers):
    write_samples(folder, numbers, keys)
    assert "3 samples per pixel" in import_dump(folder, "--exposure", "1")
    found = sorted(frame_of(folder, 1).pool.radiance[0, :, 0, 0, 0].tolist())
    assert found == [1 / 8, 2 / 8, 3 / 8]


def test_a_gap_in_the_numbers_of_layers_is_an_error(folder):
    write_samples(folder, ("1", "3"), LAYERS)
    assert "those numbered 1, 3" in import_dump(folder, code=2)


def test_a_buffer_that_only_some_frames_have_is_an_error(folder):
    planes = {n: p for n, p in aovs().items() if not n.startswith("depth")}
    write(folder, "aov.1001.exr", planes)
    output = import_dump(folder, code=2)
    assert "frame 1002 has the channels of [depth], frame 1001 has not" in output
