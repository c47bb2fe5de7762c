"""Attributes that the library cannot read or write stay, bit by bit, in a copy of a file."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from rlbench.apps.dumps.denoising.exr_copy import NewPixels, replace_channels
from rlbench.clips.exr import read_exr_parts, read_planes
from rlbench.clips.exr_attributes import read_strings

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
    (header,) = read_exr_parts(source)
    (plane,) = read_planes(source, header, ["R"])
    replace_channels(source, tmp_path / "out.exr", NewPixels(header, {"R": plane + 1}))
    changed, same = read_planes(tmp_path / "out.exr", header, ["R", "Z"])
    np.testing.assert_array_equal(changed, plane + 1)
    np.testing.assert_array_equal(same, plane)
    after = b"zzz\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    assert after in (tmp_path / "out.exr").read_bytes()
    assert ("owner", "me") in read_strings(tmp_path / "out.exr")
