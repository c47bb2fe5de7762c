"""EXR files with damage: no bit of a header ends the process or changes a pixel."""

from __future__ import annotations

import os
import resource
import signal
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from rlbench.clips.exr import ExrHeaderError, read_exr, read_exr_header, read_exr_parts, write_exr
from rlbench.clips.header import ClipError
from rlbench.system import paths

H, W = 24, 16
NAMES = ["albedo.R", "depth.Z"]
PER_PROCESS = 200  # flips in one child process
RIGHT, REFUSED, WRONG, OTHER = range(4)


@pytest.fixture
def image(tmp_path):
    """A file of four channels, smooth so that ZIP compresses it."""
    ramp = np.linspace(0, 1, H * W).reshape(H, W).round(2)
    planes = {f"albedo.{c}": ramp.astype(np.float16) for c in "RGB"}
    write_exr(tmp_path / "image.exr", planes | {"depth.Z": np.full((H, W), 3, np.float32)})
    return tmp_path / "image.exr"


def _read_flipped(path: Path, content: bytes, bit: int, truth: np.ndarray) -> int:
    """What reading a file does after one bit of it was flipped."""
    flipped = bytearray(content)
    flipped[bit // 8] ^= 1 << bit % 8
    path.write_bytes(flipped)
    try:
        pixels = read_exr(path, NAMES, H, W)
    except ClipError:
        return REFUSED
    except Exception:
        return OTHER
    return RIGHT if np.array_equal(pixels, truth) else WRONG


def _flip_in_a_process(path: Path, bits: list[int]) -> Counter[str]:
    """What reading does after each of these flips, counted; run in a child that may die."""
    content, truth = path.read_bytes(), read_exr(path, NAMES, H, W)
    outcomes, child_outcomes = os.pipe()
    if (child := os.fork()) == 0:
        signal.alarm(60)  # a hang is a failure
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # OpenEXR writes its errors there
        for bit in bits:
            os.write(
                child_outcomes, bytes([_read_flipped(path.with_name("b"), content, bit, truth)])
            )
        os._exit(0)
    os.close(child_outcomes)
    with os.fdopen(outcomes, "rb") as pipe:
        counts = Counter(("right", "refused", "wrong", "other")[code] for code in pipe.read())
    _, status = os.waitpid(child, 0)
    return counts + Counter({"crashed": int(status != 0)})


def _header_bits(path: Path) -> int:
    return path.read_bytes().index(b"scanlineimage\0") * 8 + 14 * 8


@pytest.mark.parametrize("stride", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_no_flipped_bit_of_a_header_crashes_or_changes_a_pixel(image, stride):
    bits = list(range(0, _header_bits(image), stride))
    counts: Counter[str] = Counter()
    for start in range(0, len(bits), PER_PROCESS):
        counts += _flip_in_a_process(image, bits[start : start + PER_PROCESS])
    assert counts.keys() == {"right", "refused"}
    assert counts.total() == len(bits) > 2100 // stride


@pytest.mark.parametrize("stride", [11, pytest.param(1, marks=pytest.mark.slow)])
def test_almost_every_flipped_bit_of_compressed_pixels_is_refused(image, stride):
    bits = list(range(_header_bits(image), image.stat().st_size * 8, stride))
    counts = _flip_in_a_process(image, bits)
    assert counts.keys() <= {"right", "refused", "wrong"}
    assert (
        counts["wrong"] <= len(bits) // 200
    )  # ZIP's checksum misses a few bits of its own framing


def test_the_reader_agrees_with_the_library(image):
    header, library = read_exr_header(image), OpenEXR.InputFile(str(image)).header()
    assert list(header.channels) == sorted(library["channels"])
    assert header.size == (H, W)
    assert {c.pixel_type for c in header.channels.values()} == {"HALF", "FLOAT"}
    assert all(c.is_float for c in header.channels.values())


def window(right: int, bottom: int) -> bytes:
    return struct.pack("<4i", 0, 0, right, bottom)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"albedo.B", b"\xfflbedo.B", "not UTF-8|not sorted"),
        (b"albedo.B", b"zlbedo.B", "not sorted"),
        (b"dataWindow", b"dbtaWindow", "has no attribute dataWindow"),
        (b"v/1\x01", b"v/1\x02", "it begins with"),
        (b"\x02\x00\x00\x00channels", b"\x02\x08\x00\x00channels", "deep image; flatten"),
        (window(W - 1, H - 1), window(W - 1, 2**20), "chunks; the .* its header are too few"),
        (window(W - 1, H - 1), window(2**20, 2**20), "claims to be 1048577 x 1048577 pixels"),
    ],
)
def test_a_header_that_is_wrong_is_explained(image, old, new, message):
    content = image.read_bytes()
    assert old in content
    image.write_bytes(content.replace(old, new, 1))
    with pytest.raises(ExrHeaderError, match=message):
        read_exr_header(image)
    with pytest.raises(ClipError, match="cannot be decoded, truncated or corrupt .*delete it"):
        read_exr(image, NAMES, H, W)


def test_a_full_disk_leaves_no_file_and_is_explained(tmp_path):
    """A limit on the size of files stands for a full disk, which the library reports alike."""
    noise = np.random.default_rng(0).random((64, 64)).astype(np.float32)
    if (child := os.fork()) == 0:
        code = 1
        try:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (600, 600))
            write_exr(tmp_path / "image.exr", {"R": noise})
        except paths.WriteError as error:
            code = 0 if "bytes free" in str(error) and "\n" not in str(error) else 2
        finally:
            os._exit(code)
    assert os.waitpid(child, 0)[1] == 0
    assert list(tmp_path.iterdir()) == []


def _write_parts(path: Path) -> None:
    layout = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    ramp = np.linspace(0, 1, H * W, dtype=np.float32).reshape(H, W)
    parts = [OpenEXR.Part(dict(layout), {"R": ramp}, "beauty")]
    parts.append(OpenEXR.Part(dict(layout), {"Z": ramp, "id": ramp}, "depth"))
    OpenEXR.File(parts).write(str(path))


def test_the_headers_of_all_parts_are_those_that_the_library_reads(tmp_path):
    _write_parts(tmp_path / "parts.exr")
    found = {h.name: (list(h.channels), h.size) for h in read_exr_parts(tmp_path / "parts.exr")}
    with OpenEXR.File(str(tmp_path / "parts.exr"), separate_channels=True) as file:
        expected = {part.name(): (sorted(part.channels), (H, W)) for part in file.parts}
    assert found == expected
    with pytest.raises(ExrHeaderError, match="it has several parts"):  # so no file of a clip
        read_exr_header(tmp_path / "parts.exr")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_truncated_header_of_several_parts_is_refused(tmp_path, share):
    path = tmp_path / "parts.exr"
    _write_parts(path)
    content = path.read_bytes()
    end = content.index(b"\0\0", content.rindex(b"screenWindowWidth"))
    path.write_bytes(content[: int(end * share)])
    with pytest.raises(ExrHeaderError):
        read_exr_parts(path)
