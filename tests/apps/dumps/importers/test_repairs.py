"""Values that no clip may hold, and windows: what is said, repaired and counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from typer.testing import CliRunner

from rlbench.cli.app import app
from rlbench.clips.stored import open_clip, verify
from tests.apps.dumps.importers.small_dumps import H, W, aovs, rgb, write, write_dump

NEXT = (3, 4)  # the neighbour whose value is taken: to the left


def import_dump(folder: Path, *words: str, code: int = 0) -> str:
    """The output of an import of folder/dump to folder/out."""
    arguments = ["import", str(folder / "dump"), "--layout", str(folder / "layout.toml")]
    result = CliRunner().invoke(app, [*arguments, "--out", str(folder / "out"), *words])
    assert result.exit_code == code, result.output
    return " ".join(result.output.split())


def frame_of(folder: Path, index: int):
    return open_clip(folder / "out" / "dump", seed=0).frame(index)


def pixel(image, row=3, column=5) -> np.ndarray:
    return image[..., row, column].squeeze().numpy()


def break_image(folder: Path, place: str, value: float, frame: int = 1002) -> None:
    image = rgb(0.5)
    image["G"][3, 5] = value
    write(folder / "dump" / place / f"b.{frame}.exr", image)


def break_buffer(folder: Path, name: str, value: float, channels: str) -> None:
    planes = aovs()
    for channel in channels:
        planes[f"{name}.{channel}"][3, 5] = value
    write(folder / "dump" / "aov.1002.exr", planes)


@pytest.mark.parametrize(
    ("place", "value"), [("s0", np.nan), ("s1", np.inf), ("rA", -np.inf), ("rB", np.nan)]
)
def test_radiance_that_is_not_finite_names_file_frame_and_remedy(tmp_path, place, value):
    write_dump(tmp_path)
    break_image(tmp_path, place, value)
    output = import_dump(tmp_path, code=2)
    assert f"{place}/b.1002.exr" in output.replace(" ", "")
    assert "in frame 1002 of clip 'dump'" in output
    assert "x 5, y 3" in output
    assert "--exposure" not in output
    repaired = import_dump(tmp_path, "--sanitize")  # the remedy helps
    kind = "radiance" if place[0] == "s" else "reference"
    assert f"1 pixels of {kind} were repaired, first in frame 1002" in repaired
    assert verify(tmp_path / "out" / "dump") == []
    frame = frame_of(tmp_path, 1)
    values = {
        "s": pixel(frame.pool.radiance).min(),
        "rA": pixel(frame.reference.half_a).max(),
        "rB": pixel(frame.reference.half_b).max(),
    }
    assert values["s" if place[0] == "s" else place] == 0  # black, as the core makes it
    assert sum(value == 0 for value in values.values()) == 1


def test_emission_that_is_not_finite_is_named(tmp_path):
    write_dump(tmp_path)
    layout = tmp_path / "layout.toml"
    layout.write_text(layout.read_text() + '[emission]\nfiles = "e.{frame}.exr"\n')
    for frame in (1001, 1002, 1003):
        image = rgb(0.5)
        image["B"][7, 7] = np.nan if frame == 1003 else 0
        write(tmp_path / "dump" / f"e.{frame}.exr", image)
    assert "dump/e.1003.exr: " in import_dump(tmp_path, code=2).replace("dump/ ", "dump/")


def test_a_firefly_survives_sanitizing_and_negative_radiance_does_not(tmp_path):
    write_dump(tmp_path)
    image = rgb(0.5)
    image["R"][0, 0], image["R"][1, 1] = 3e6, -2
    write(tmp_path / "dump" / "s0" / "b.1001.exr", image)
    assert "1 pixels of radiance were repaired" in import_dump(
        tmp_path, "--sanitize", "--exposure", "1"
    )
    radiance = frame_of(tmp_path, 0).pool.radiance
    assert radiance.max() == 3e6
    assert sorted(radiance[0, :, 0, 1, 1].tolist()) == [0, 0.5]


@pytest.mark.parametrize(
    ("encoded", "channels", "value"),
    [(False, "X", np.nan), (True, "YZ", np.inf), (False, "XYZ", -np.inf), (True, "X", np.nan)],
)
def test_normals_that_are_not_finite_are_counted(tmp_path, encoded, channels, value):
    write_dump(tmp_path)
    layout = tmp_path / "layout.toml"
    layout.write_text(
        layout.read_text().replace("[depth]", f"encoded = {str(encoded).lower()}\n[depth]")
    )
    break_buffer(tmp_path, "normal", value, channels)
    output = import_dump(tmp_path)
    assert "1 pixels of normal are NaN or infinite, and became background, first in frame" in output
    assert (pixel(frame_of(tmp_path, 1).gbuffer.normal) == 0).all()
    assert "--sanitize" in output


@pytest.mark.parametrize(
    ("name", "channels", "value"),
    [
        ("normal", "Y", np.nan),
        ("albedo", "RGB", np.inf),
        ("motion", "X", -np.inf),
        ("depth", "Z", np.nan),
    ],
)
def test_sanitized_buffers_take_the_value_of_a_neighbour(tmp_path, name, channels, value):
    write_dump(tmp_path)
    break_buffer(tmp_path, name, value, channels)
    assert f"1 pixels of {name} were repaired, first in frame 1002" in import_dump(
        tmp_path, "--sanitize"
    )
    buffer = getattr(frame_of(tmp_path, 1).gbuffer, name)
    np.testing.assert_array_equal(pixel(buffer), pixel(buffer, *NEXT))
    assert np.isfinite(pixel(buffer)).all()


def test_what_a_sky_has_in_place_of_a_normal_is_no_damage(tmp_path):
    write_dump(tmp_path)
    planes = aovs()
    planes["depth.Z"][:5] = np.inf
    for letter in "XYZ":
        planes[f"normal.{letter}"][:5] = np.nan
    write(tmp_path / "dump" / "aov.1002.exr", planes)
    assert "pixels of normal" not in import_dump(tmp_path, "--sanitize")
    assert (frame_of(tmp_path, 1).gbuffer.normal[0, :, :5] == 0).all()


def test_a_whole_dump_is_not_repaired(tmp_path):
    write_dump(tmp_path)
    output = import_dump(tmp_path, "--sanitize")
    assert "repaired" not in output
    assert "note:" not in output


# Windows


def test_a_crop_is_empty_outside_and_counted(tmp_path):
    write_dump(tmp_path)
    rows, columns = slice(2, 9), slice(3, 20)
    window = {"dataWindow": ((3, 2), (19, 8)), "displayWindow": ((0, 0), (W - 1, H - 1))}
    crop = {name: np.ascontiguousarray(p[rows, columns]) for name, p in aovs().items()}
    write(tmp_path / "dump" / "aov.1002.exr", crop, **window)
    for place in ("s1", "rA"):
        image = {name: np.ascontiguousarray(p[rows, columns]) for name, p in rgb(0.5).items()}
        write(tmp_path / "dump" / place / "b.1002.exr", image, **window)
    output = import_dump(tmp_path, "--exposure", "1")
    outside = np.ones((H, W), bool)
    outside[rows, columns] = False
    # four buffers, a sample and a half
    count = 6 * outside.sum()
    assert f"6 images do not fill their display window: {count} pixels are empty" in output
    assert "first in frame 1002" in output
    frame = frame_of(tmp_path, 1)
    empty = {"albedo": 0, "normal": 0, "depth": np.inf, "motion": 0}
    whole = frame_of(tmp_path, 0)
    for name, value in empty.items():
        found = getattr(frame.gbuffer, name)[0].numpy()
        assert (found[:, outside] == value).all()
        expected = getattr(whole.gbuffer, name)[0].numpy()
        np.testing.assert_array_equal(found[:, ~outside], expected[:, ~outside])
    np.testing.assert_array_equal(
        frame.reference.half_a[0].numpy(), np.where(outside, 0, np.float32(0.5))[None].repeat(3, 0)
    )
    assert sorted(frame.pool.radiance[0, :, 0, 0, 0].tolist()) == [0, 0.5]


@pytest.mark.parametrize("convention", ["encoded", "offset", "inverse", "to next"])
def test_what_is_outside_a_crop_is_empty_in_any_convention(tmp_path, convention):
    write_dump(tmp_path)
    keys = {
        "encoded": ("[depth]", "encoded = true\n[depth]"),
        "offset": ("[motion]", '[motion]\noffset = 0.5\nunit = "shares"'),
        "inverse": ("[depth]", '[depth]\nkind = "inverse"'),
        "to next": ("[motion]", '[motion]\npoints = "to next"'),
    }
    layout = tmp_path / "layout.toml"
    layout.write_text(layout.read_text().replace(*keys[convention], 1))
    window = {"dataWindow": ((3, 2), (19, 8)), "displayWindow": ((0, 0), (W - 1, H - 1))}
    for frame in (1001, 1002, 1003):
        crop = {n: np.ascontiguousarray(p[2:9, 3:20]) for n, p in aovs().items()}
        write(tmp_path / "dump" / f"aov.{frame}.exr", crop, **window)
    import_dump(tmp_path)
    gbuffer = frame_of(tmp_path, 2).gbuffer
    assert (pixel(gbuffer.motion, -1, 0) == 0).all()
    assert (pixel(gbuffer.normal, -1, 0) == 0).all()
    assert pixel(gbuffer.depth, -1, 0) == np.inf


def test_overscan_is_cut_and_counted(tmp_path):
    write_dump(tmp_path)
    wide = {name: np.pad(plane, 2, mode="edge") for name, plane in rgb(0.25).items()}
    window = {
        "dataWindow": ((-2, -2), (W + 1, H + 1)),
        "displayWindow": ((0, 0), (W - 1, H - 1)),
    }
    write(tmp_path / "dump" / "s0" / "b.1003.exr", wide, **window)
    pixels = (W + 4) * (H + 4) - W * H
    assert f"1 images have overscan: {pixels} pixels outside the display" in import_dump(tmp_path)


# Files of text, and samples in one file


def test_a_layout_with_a_byte_order_mark_is_read(tmp_path):
    write_dump(tmp_path)
    layout = tmp_path / "layout.toml"
    layout.write_bytes(b"\xef\xbb\xbf" + layout.read_bytes())
    import_dump(tmp_path)


@pytest.mark.parametrize(
    ("pattern", "numbers"),
    [("s{sample}.R", "012"), ("*{sample}.R", "123"), ("s{sample}.R", ("001", "002", "003"))],
)
def test_samples_in_layers_are_numbered_from_any_number(tmp_path, numbers, pattern):
    write_dump(tmp_path)
    channels = ", ".join(f'"{pattern[:-1]}{c}"' for c in "RGB")
    layout = tmp_path / "layout.toml"
    text = layout.read_text().replace(
        '"s{sample}/b.{frame}.exr"', f'"all.{{frame}}.exr"\nchannels = [{channels}]'
    )
    layout.write_text(text)
    for frame in (1001, 1002, 1003):
        planes = {}
        for slot, number in enumerate(numbers):
            planes |= rgb((slot + 1) / 8, f"s{number}.")
        write(tmp_path / "dump" / f"all.{frame}.exr", planes)
    assert "3 samples per pixel" in import_dump(tmp_path, "--exposure", "1")
    found = sorted(frame_of(tmp_path, 1).pool.radiance[0, :, 0, 0, 0].tolist())
    assert found == [1 / 8, 2 / 8, 3 / 8]


def test_samples_in_parts_are_numbered_from_any_number(tmp_path):
    write_dump(tmp_path)
    layout = tmp_path / "layout.toml"
    layout.write_text(
        layout.read_text().replace(
            '"s{sample}/b.{frame}.exr"',
            '"all.{frame}.exr"\npart = "s{sample}"\nchannels = ["R", "G", "B"]',
        )
    )
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    for frame in (1001, 1002, 1003):
        parts = [OpenEXR.Part(dict(header), rgb(s / 8), f"s{s}") for s in (3, 1, 2)]
        OpenEXR.File(parts).write(str(tmp_path / "dump" / f"all.{frame}.exr"))
    import_dump(tmp_path, "--exposure", "1")
    found = sorted(frame_of(tmp_path, 1).pool.radiance[0, :, 0, 0, 0].tolist())
    assert found == [1 / 8, 2 / 8, 3 / 8]


def test_a_gap_in_the_numbers_of_layers_is_an_error(tmp_path):
    write_dump(tmp_path)
    layout = tmp_path / "layout.toml"
    text = layout.read_text().replace(
        '"s{sample}/b.{frame}.exr"',
        '"all.{frame}.exr"\nchannels = ["s{sample}.R", "s{sample}.G", "s{sample}.B"]',
    )
    layout.write_text(text)
    for frame in (1001, 1002, 1003):
        write(tmp_path / "dump" / f"all.{frame}.exr", rgb(0.5, "s1.") | rgb(0.5, "s3."))
    assert "those numbered 1, 3" in import_dump(tmp_path, code=2)


def test_a_buffer_that_only_some_frames_have_is_an_error(tmp_path):
    write_dump(tmp_path)
    planes = {n: p for n, p in aovs().items() if not n.startswith("depth")}
    write(tmp_path / "dump" / "aov.1001.exr", planes)
    assert "frame 1002 has the channels of [depth], frame 1001 has not" in import_dump(
        tmp_path, code=2
    )
