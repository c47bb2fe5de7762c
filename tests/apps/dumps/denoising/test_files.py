"""Files in, files out: what is replaced, what stays, and what a killed command resumes."""

from __future__ import annotations

import os
import resource
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import tomli_w

import rlbench
from rlbench.apps.dumps.denoising import UNKNOWN_SPP, exr_copy
from rlbench.apps.dumps.denoising.files import GapError, find_noisy_sequences
from rlbench.apps.dumps.denoising.shot import STATE_PERIOD, denoise_sequence
from rlbench.apps.dumps.importers.layout import ready_layouts
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from rlbench.clips import exr
from rlbench.clips.exr_attributes import read_strings
from rlbench.denoise import DenoiseError
from rlbench.errors import SourceError
from tests.apps.dumps.exr_files import read_image, read_parts, read_planes, write_file
from tests.apps.dumps.importers.dumps import halves, write_blender, write_falcor
from tests.apps.dumps.lint.broken_fixtures import correct_clip

ROW = "accumulate/tuned"
FRAMES = STATE_PERIOD + 3
SPP = "cycles.ViewLayer.samples"  # an attribute of Blender


@pytest.fixture(scope="module")
def arrays() -> ClipArrays:
    return correct_clip(frames=FRAMES, half=16)


@pytest.fixture(scope="module")
def render(arrays, tmp_path_factory) -> Path:
    """A folder of frames as Blender writes them, with one image each."""
    folder = tmp_path_factory.mktemp("dump")
    write_blender(arrays, folder)
    for path in (folder / "sample0").iterdir():
        edit(path, {SPP: "4"})
    return shutil.move(folder / "sample0", folder / "render")


@pytest.fixture
def copy(render, tmp_path) -> Path:
    return shutil.copytree(render, tmp_path / "render")


@pytest.fixture(scope="module")
def whole(render, tmp_path_factory) -> Path:
    """All frames, denoised in one go."""
    out = tmp_path_factory.mktemp("whole")
    run(render, out)
    return out


def edit(path: Path, attributes=(), channels=(), **header) -> None:
    """Change attributes of a file's first part, and add channels to it."""
    kept, pixels = read_parts(path)[0]
    kept.pop("chunkCount", None)
    write_file(path, {"": pixels | dict(channels)}, **{**kept, **dict(attributes), **header})


def run(
    source: Path,
    out: Path,
    layout: str = "blender",
    row: str = ROW,
    on_frame=lambda: None,
    **options,
):
    method = rlbench.load_method(row)
    shots = find_noisy_sequences(source, layout, has_memory=method.traits.temporal, **options)
    return [denoise_sequence(shot, method, row, out, on_frame=on_frame) for shot in shots]


def assert_only_replaced(source: Path, target: Path, names: set[str], packing: str = "") -> None:
    """Everything but `names` is bit by bit that of the source, and these are others."""
    pairs = zip(read_parts(source), read_parts(target), strict=True)
    for (header, part), (new_header, new) in pairs:
        if packing:
            header["compression"] = packing
        assert {k: str(v) for k, v in new_header.items()} == {k: str(v) for k, v in header.items()}
        assert list(new) == list(part)
        for name, pixels in part.items():
            assert new[name].dtype == pixels.dtype
            assert new[name].shape == pixels.shape
            same = new[name].tobytes() == pixels.tobytes()
            assert same != (name in names), name


COMBINED = {f"ViewLayer.Combined.{letter}" for letter in "RGB"}


def test_all_but_the_radiance_is_kept_bit_by_bit(render, whole):
    assert {path.name for path in whole.glob("*.exr")} == {path.name for path in render.iterdir()}
    for path in render.iterdir():
        assert_only_replaced(path, whole / path.name, COMBINED)


def test_images_are_those_of_the_python_function(render, whole):
    (shot,) = find_noisy_sequences(render, "blender")
    assert shot.read(0).spp == 4
    images = rlbench.denoise(map(shot.read, range(3)), ROW, exposure=shot.estimate_exposure())
    for path, image in zip(sorted(whole.glob("*.exr")), images, strict=False):
        stored = read_image(path, "ViewLayer.Combined.")
        np.testing.assert_array_equal(stored, image[0].movedim(0, -1).numpy())


WINDOW = (np.array([0, 0], np.int32), np.array([99, 67], np.int32))  # beyond 96 x 72, and within


@pytest.mark.parametrize(
    ("header", "packing"),
    [
        ({"compression": OpenEXR.PIZ_COMPRESSION}, ""),
        ({"compression": OpenEXR.DWAA_COMPRESSION}, str(OpenEXR.ZIP_COMPRESSION)),
        ({"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}, ""),
        ({"displayWindow": WINDOW}, ""),
    ],
    ids=["piz", "lossy", "tiles", "window"],
)
def test_files_of_any_packing_type_and_window_are_kept(copy, tmp_path, header, packing):
    path = sorted(copy.iterdir())[0]
    crypto = {"Crypto.id": np.arange(72 * 96, dtype=np.uint32).reshape(72, 96)}
    edit(path, {"owner": "me"}, crypto, **header)
    run(path, tmp_path / "out")
    assert_only_replaced(path, tmp_path / "out" / path.name, COMBINED, packing)
    files = (path, tmp_path / "out" / path.name)
    before, after = (read_image(file, "ViewLayer.Combined.") for file in files)
    assert (after != before).mean() > 0.9  # outside the image, too


def test_half_numbers_and_other_parts_are_kept(arrays, tmp_path):
    color = halves(arrays.pools["path"][0, 0], "RGB")
    albedo = halves(arrays.gbuffer["albedo"][0], "RGB", "alb.")
    normal = halves(arrays.gbuffer["normal"][0], "XYZ")
    write_file(tmp_path / "in" / "still.exr", {"beauty": color, "aux": albedo | normal})
    layout = tmp_path / "own.toml"
    tables = {
        "radiance": {"part": "beauty", "flip": "vertical"},
        "albedo": {"channels": list(albedo), "flip": "vertical"},
        "normal": {"channels": list(normal), "flip": "vertical"},
    }
    layout.write_text(tomli_w.dumps({k: {"files": "*.exr"} | v for k, v in tables.items()}))
    run(tmp_path / "in" / "still.exr", tmp_path / "out", str(layout), "oidn", spp=1)
    source, target = (tmp_path / folder / "still.exr" for folder in ("in", "out"))
    assert_only_replaced(source, target, {"R", "G", "B"})
    stored = read_image(target).astype(np.float32)
    error = np.abs(stored - arrays.reference[0].movedim(0, -1).numpy()).mean()
    assert error < 0.5 * np.abs(color["R"] - arrays.reference[0, 0].numpy()).mean()


class Killed(BaseException):
    pass


def kill_after(frames: int):
    """A callback that kills the command after so many frames."""
    remaining = iter(range(frames - 1))

    def on_frame():
        if next(remaining, None) is None:
            raise Killed

    return on_frame


@pytest.mark.parametrize("has_state", [True, False], ids=["from its state", "from the first frame"])
@pytest.mark.parametrize("row", ["accumulate/tuned", "ours", "nppd"])
def test_a_killed_command_resumes_to_the_same_images(render, tmp_path, row, has_state):
    with pytest.raises(Killed):
        run(render, tmp_path / "killed", row=row, on_frame=kill_after(STATE_PERIOD + 1))
    (state,) = (tmp_path / "killed").glob("*.safetensors")
    if not has_state:
        state.unlink()
    times = {p: p.stat().st_mtime_ns for p in (tmp_path / "killed").glob("*.exr")}
    (summary,) = run(render, tmp_path / "killed", row=row)
    assert (summary.kept, summary.written) == (STATE_PERIOD + 1, FRAMES - STATE_PERIOD - 1)
    assert all(path.stat().st_mtime_ns == time for path, time in times.items())
    assert not list((tmp_path / "killed").glob("*.safetensors"))
    run(render, tmp_path / "whole", row=row)
    for path in (tmp_path / "whole").glob("*.exr"):
        assert path.read_bytes() == (tmp_path / "killed" / path.name).read_bytes()


def test_a_frame_that_was_replaced_is_denoised_again_and_all_after_it(copy, whole, tmp_path):
    """Whatever the dates: those of a file that was only touched or copied say nothing."""
    out = shutil.copytree(whole, tmp_path / "out", copy_function=shutil.copyfile)
    times = [path.stat() for path in sorted(copy.iterdir())]
    for path in copy.iterdir():
        os.utime(path)
    (summary,) = run(copy, out)
    assert (summary.kept, summary.written) == (FRAMES, 0)
    changed = sorted(copy.iterdir())[4]
    edit(changed, {"owner": "another"})
    os.utime(changed, ns=(times[4].st_atime_ns, times[4].st_mtime_ns))
    with pytest.raises(Killed):
        run(copy, out, on_frame=kill_after(6))
    (summary,) = run(copy, out)
    assert (summary.kept, summary.written) == (6, FRAMES - 6)


@pytest.mark.parametrize("row", [ROW, "oidn"])
def test_files_that_something_else_wrote_are_never_replaced(copy, tmp_path, row):
    out = shutil.copytree(copy, tmp_path / "out")
    with pytest.raises(DenoiseError, match="did not write"):
        run(copy, out, row=row)
    shutil.rmtree(out)
    run(copy, out, row=row)
    foreign = sorted(out.glob("*.exr"))[2]
    shutil.copy(copy / foreign.name, foreign)
    with pytest.raises(DenoiseError, match="changed since"):
        run(copy, out, row=row)
    foreign.unlink()
    (summary,) = run(copy, out, row=row)
    assert summary.written == (1 if row == "oidn" else FRAMES - 2)


@pytest.mark.parametrize("content", ["", "{", "[]", '{"settings": 3, "frames": {}}'])
def test_a_damaged_record_is_set_aside(copy, tmp_path, content):
    run(copy, tmp_path / "out", row="oidn")
    (record,) = (tmp_path / "out").glob("*.denoise.json")
    record.write_text(content)
    (summary,) = run(copy, tmp_path / "out", row="oidn")
    assert summary.written == FRAMES
    assert "set aside" in summary.notes[0]
    assert record.with_name(f"{record.name}.damaged").read_text() == content


@pytest.mark.parametrize("warm_up", [0, 2, 16])
def test_a_piece_of_a_shot_begins_with_the_memory_of_frames_before_it(
    render, whole, tmp_path, warm_up
):
    first = FRAMES // 2  # of frames 1 to FRAMES
    for piece in ((1, first), (first, FRAMES + 1)):
        (summary,) = run(render, tmp_path / "out", frames=piece, warm_up=warm_up)
        assert summary.written == piece[1] - piece[0]
    (shot,) = find_noisy_sequences(render, "blender", frames=piece, warm_up=warm_up)
    assert shot.start == min(warm_up, first - 1)
    files = sorted((tmp_path / "out").glob("*.exr"))
    same = [path.read_bytes() == (whole / path.name).read_bytes() for path in files]
    assert len(same) == FRAMES
    assert all(same[: first - 1])
    assert all(same) == (warm_up >= first - 1)


def test_the_whole_shot_may_follow_a_piece(render, whole, tmp_path):
    run(render, tmp_path, frames=(2, 4))
    (summary,) = run(render, tmp_path)
    assert summary.written == FRAMES
    for path in whole.glob("*.exr"):
        assert path.read_bytes() == (tmp_path / path.name).read_bytes()


@pytest.mark.parametrize("row", [ROW, "oidn"])
def test_gaps_are_for_rows_without_memory(copy, tmp_path, row):
    for path in sorted(copy.iterdir())[1::2]:
        path.unlink()
    if row == ROW:
        with pytest.raises(GapError, match="-m oidn"):
            run(copy, tmp_path / "out", row=row)
        return
    (summary,) = run(copy, tmp_path / "out", row=row, frames=(1, FRAMES))
    assert summary.written == FRAMES // 2


def test_a_folder_of_other_settings_is_refused(render, whole):
    with pytest.raises(DenoiseError, match="method"):
        run(render, whole, row="oidn")
    with pytest.raises(DenoiseError, match="noisy"):
        run(render, render)


def test_missing_motion_is_said_and_static_needs_none(copy, tmp_path):
    layout = tmp_path / "no_motion.toml"
    layout.write_text(ready_layouts()["blender"].read_text().partition("\n[motion]")[0])
    with pytest.raises(SourceError, match="--static"):
        run(copy, tmp_path / "out", str(layout))
    (summary,) = run(copy, tmp_path / "out", str(layout), is_static=True, frames=(1, 3))
    assert summary.written == 2
    run(copy, tmp_path / "alone", str(layout), row="oidn", needs_motion=False, frames=(1, 3))


def test_the_primaries_of_a_file_are_kept(tmp_path):
    """Even of colours that Rec. 709 cannot show."""
    green = {f"ViewLayer.Combined.{c}": np.full((72, 96), c == "G", np.float32) for c in "RGB"}
    write_file(tmp_path / "in" / "still.exr", {"": green}, colorInteropID="lin_rec2020_scene")
    (shot,) = find_noisy_sequences(tmp_path / "in" / "still.exr", "blender", spp=4)
    assert any("chromaticities are kept: red 0.708" in note for note in shot.notes)
    run(tmp_path / "in" / "still.exr", tmp_path / "out", row="oidn", spp=4)
    ((header, channels),) = read_parts(tmp_path / "out" / "still.exr")
    assert header["colorInteropID"] == "lin_rec2020_scene"
    for name, pixels in green.items():
        assert channels[name].mean() == pytest.approx(pixels.mean(), abs=0.02)  # by a network


def test_a_shot_that_begins_in_the_dark_keeps_its_light(tmp_path):
    rng = np.random.default_rng(0)
    noise = rng.gamma(9, 1 / 9, (4, 32, 48)).astype(np.float32)
    noise *= np.array([1e-6, 1e-4, 1.0, 1.0], np.float32)[:, None, None]
    for frame, plane in enumerate(noise):
        planes = {f"ViewLayer.Combined.{c}": plane for c in "RGB"}
        write_file(tmp_path / "in" / f"{frame:04}.exr", {"": planes})
    (shot,) = find_noisy_sequences(tmp_path / "in", "blender", spp=9, needs_motion=False)
    assert shot.estimate_exposure() == pytest.approx(0.18, rel=0.1)
    run(tmp_path / "in", tmp_path / "out", row="oidn", spp=9, needs_motion=False)
    for frame in (2, 3):
        channels = read_planes(tmp_path / "out" / f"{frame:04}.exr")
        assert channels["ViewLayer.Combined.G"].mean() == pytest.approx(1, rel=0.05)


def test_several_images_of_a_frame_are_no_mean(arrays, tmp_path):
    write_falcor(arrays, tmp_path)
    with pytest.raises(SourceError, match="rlbench import"):
        run(tmp_path, tmp_path / "out", "falcor", spp=1)


@pytest.mark.parametrize("layout", ["nrd-sample", "noisebase"])
def test_a_layout_whose_radiance_is_in_parts_is_refused(render, tmp_path, layout):
    with pytest.raises(SourceError, match=layout):
        run(render, tmp_path, layout)


def test_samples_are_counted_by_name_option_or_not_at_all(arrays, copy, tmp_path):
    mean = halves(arrays.half_a[0], "RGB")
    write_file(tmp_path / "mean" / "room_0000_0256spp.hdr.exr", {"": mean})
    (shot,) = find_noisy_sequences(tmp_path / "mean", "oidn")
    assert shot.read_spp(0) == 256
    (shot,) = find_noisy_sequences(copy, "blender", spp=12)
    assert shot.read_spp(0) == 12
    path = sorted(copy.iterdir())[0]
    edit(path, {SPP: "some"})
    assert find_noisy_sequences(copy, "blender")[0].read_spp(0) == UNKNOWN_SPP


@pytest.mark.slow
def test_a_frame_of_4k_fits_in_memory(arrays, tmp_path):
    """One 3840 x 2160 frame, by real files; 12 GB is what a small workstation has to spare."""
    h, w = 2160, 3840
    write_blender(arrays, tmp_path / "dump")
    path = next((tmp_path / "dump" / "sample0").iterdir())
    y, x = np.arange(h) % 90, np.arange(w) % 120  # of the small image, again and again
    big = {
        name: pixels[y % len(pixels)][:, x % pixels.shape[1]]
        for name, pixels in read_planes(path).items()
    }
    write_file(tmp_path / "in" / "big0001.exr", {"": big})
    run(tmp_path / "in", tmp_path / "out", spp=64)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    source, target = (tmp_path / folder / "big0001.exr" for folder in ("in", "out"))
    assert_only_replaced(source, target, COMBINED)
    assert peak < 12


@pytest.mark.slow
def test_an_animation_by_blender_is_denoised(tmp_path):
    from rlbench.apps.render.cycles import process

    if not process.bpy_version():
        pytest.skip(process.INSTALL_HINT)
    script = Path(__file__).parents[2] / "render" / "cycles" / "write_dump.py"
    command = [process.interpreter(), str(script), str(tmp_path / "dump")]
    subprocess.run(command, check=True, capture_output=True)
    (summary,) = run(tmp_path / "dump" / "geometry", tmp_path / "out")
    assert summary.written == 3
    truth, noisy, image = (
        read_image(tmp_path / folder / "shot0003.exr", "ViewLayer.Combined.")
        for folder in ("dump/referenceA", "dump/geometry", "out")
    )
    assert np.abs(image - truth).mean() < 0.5 * np.abs(noisy - truth).mean()


# Attributes that the library cannot read or write stay in a copy of a file


VALUES = {  # by type, of which some have no value that the library takes
    "Latin-1": ("string", "J\u00f6rg".encode("latin-1")),
    "no text": ("string", b"\xff" * 24),
    "words": ("stringvector", struct.pack("<i", 2) + b"\xff\xfe"),
    "an empty list": ("floatvector", b""),
    "no words": ("stringvector", b""),
    "deep": ("deepImageState", b"\1"),
    "a key code": ("keycode", b"\0" * 28),
    "a manifest": ("idmanifest", b"\0" * 8),
    "an unknown type": ("own", b"\1\2"),
}


def write_with(path: Path, kind: str, value: bytes) -> Path:
    """A file of one channel with the attribute zzz, the last of its header."""
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage, "owner": "me"}
    plane = np.arange(48, dtype=np.float32).reshape(6, 8)
    OpenEXR.File({**header, "zzz": "x"}, {"R": plane, "Z": plane}).write(str(path))
    before = b"zzz\0string\0" + struct.pack("<i", 1) + b"x"
    after = b"zzz\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    head, _, tail = path.read_bytes().partition(before)
    shift, table = len(after) - len(before), struct.unpack("<6Q", tail[1:49])
    moved = struct.pack("<6Q", *(offset + shift for offset in table))
    path.write_bytes(head + after + tail[:1] + moved + tail[49:])
    return path


@pytest.mark.parametrize("case", VALUES)
def test_an_attribute_stays_and_pixels_change(tmp_path, case):
    kind, value = VALUES[case]
    source = write_with(tmp_path / "in.exr", kind, value)
    (header,) = exr.read_exr_parts(source)
    (plane,) = exr.read_planes(source, header, ["R"])
    exr_copy.replace_channels(
        source, tmp_path / "out.exr", exr_copy.NewPixels(header, {"R": plane + 1})
    )
    changed, same = exr.read_planes(tmp_path / "out.exr", header, ["R", "Z"])
    np.testing.assert_array_equal(changed, plane + 1)
    np.testing.assert_array_equal(same, plane)
    after = b"zzz\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    assert after in (tmp_path / "out.exr").read_bytes()
    assert ("owner", "me") in read_strings(tmp_path / "out.exr")
