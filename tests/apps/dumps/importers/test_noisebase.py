"""Noisebase's zips: formulas against closed forms, and archives that are not safe."""

from __future__ import annotations

import json
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from rlbench.errors import SourceError
from tests.apps.dumps.importers.sources import (
    FAR,
    ZOOM,
    H,
    W,
    imported,
    noisebase_arrays,
    plane,
    pool,
    stored,
    write_noisebase,
    zarr_zip,
)

pytest.importorskip("numcodecs", reason="the extra noisebase is not installed")


@pytest.fixture
def clip(tmp_path):
    return imported(write_noisebase(tmp_path / "source"), "noisebase", tmp_path / "out")


def test_radiance_is_decoded_from_rgbe(clip):
    expected = noisebase_arrays(1)["color"][:3].transpose(3, 1, 2, 0) / 255
    expected[:, :, 1::2] *= 2  # exponent 255: the upper end, 2
    expected[:, :, ::2] *= 0.5  # exponent 127: half of the way from log 1/8 to log 2
    np.testing.assert_allclose(pool(clip, 1), expected, rtol=5e-4)  # half precision


def test_the_reference_is_unchanged(clip):
    assert (clip.frame(2).reference.mean.numpy() == np.float32(1 / 3 + 2)).all()


def test_depth_is_along_the_view_axis_and_infinite_in_the_sky(clip):
    expected = np.full((H, W, 1), FAR)
    expected[0] = np.inf
    np.testing.assert_allclose(stored(clip, 1, "depth"), expected, rtol=1e-6)  # float


@pytest.mark.parametrize("index", [1, 2])
def test_motion_is_that_of_camera_and_object(clip, index):
    expected = np.zeros((H, W, 2))
    expected[1:, :, 0] = -0.1 / FAR * ZOOM * W / 2  # what the camera saw further left
    expected[H // 2 :, :, 1] = -0.05 / FAR * (ZOOM * W / H) * H / 2  # was higher
    # positions are float
    np.testing.assert_allclose(stored(clip, index, "motion"), expected, atol=1e-5, rtol=0)


def test_the_sky_moves_as_the_camera_turns(tmp_path):
    source = write_noisebase(tmp_path / "source", frames=2, step=0.3, yaw=0.05)
    motion = stored(imported(source, "noisebase", tmp_path / "out"), 1, "motion")[0]
    x, y = (side[0] for side in plane())
    turned = np.tan(np.arctan(x) - 0.05) - x, y / (np.cos(0.05) + x * np.sin(0.05)) - y
    expected = np.stack((turned[0] * W / 2 * ZOOM, -turned[1] * H / 2 * ZOOM * W / H), -1)
    np.testing.assert_allclose(motion, expected, atol=1e-4, rtol=0)  # matrices are float


def test_normals_are_unchanged_and_albedo_is_clipped(clip):
    assert (stored(clip, 0, "normal")[1:] == [0, 0, -1]).all()
    assert (stored(clip, 0, "albedo") == [0.25, 0.5, 1]).all()


def test_the_first_frame_has_no_motion_which_is_a_limitation(clip):
    assert not stored(clip, 0, "motion").any()
    assert clip.header.limitations == ("halves", "first motion")


def test_the_first_frame_has_motion_if_the_frame_before_it_exists(tmp_path):
    clip = imported(write_noisebase(tmp_path / "s"), "noisebase", tmp_path / "out", frames=(1, 3))
    assert stored(clip, 0, "motion")[1, 0, 0] == pytest.approx(-0.1 / FAR * ZOOM * W / 2, abs=1e-5)
    assert clip.header.limitations == ("halves",)


def test_fewer_samples_are_the_first(tmp_path):
    clip = imported(write_noisebase(tmp_path / "s"), "noisebase", tmp_path / "out", samples=5)
    assert clip.header.pool_spp == 5
    assert pool(clip, 0)[-1, 0, 0, 0] == pytest.approx(4 / 255 / 2, rel=5e-4)  # half precision


def test_arrays_equal_those_that_zarr_reads(tmp_path):
    zarr = pytest.importorskip("zarr", reason="an oracle, not a dependency")
    write_noisebase(tmp_path, frames=1)
    store = zarr.storage.ZipStore(tmp_path / "corridor" / "frame0000.zip", mode="r")
    array = zarr.open_group(store, mode="r")["color"][:]
    np.testing.assert_array_equal(array, noisebase_arrays(0)["color"])


# Sources that cannot be imported


def _with_arrays(path: Path, **arrays: np.ndarray | None) -> None:
    """Write the frame again with some arrays replaced or left out."""
    changed = {**noisebase_arrays(1), **arrays}
    zarr_zip(path, {key: value for key, value in changed.items() if value is not None})


def _with_metadata(path: Path, **change: object) -> None:
    """Write the frame again with other metadata of "color"."""
    zarr_zip(path, noisebase_arrays(1), **change)


def _with_entry(path: Path, name: str, content: bytes) -> None:
    """Replace one entry, compressed by the zip itself."""
    with zipfile.ZipFile(path) as archive:
        entries = {entry: archive.read(entry) for entry in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, old in entries.items():
            archive.writestr(entry, content if entry == name else old)


def _lz4(size: int) -> bytes:
    from numcodecs import LZ4

    return bytes(LZ4().encode(bytes(size)))


CHUNK = "color/0.0.0.0"
BROKEN = {
    "a frame is missing": (Path.unlink, r"clip 'corridor': .* missing: 1;"),
    "no zip": (lambda p: p.write_text("<html>"), r"frame0001\.zip cannot be read, truncated"),
    "truncated": (
        lambda p: p.write_bytes(p.read_bytes()[:2000]),
        r"frame0001\.zip cannot be read, truncated",
    ),
    "no reference": (
        lambda p: _with_arrays(p, reference=None),
        r"has no 'reference', so nothing can be scored",
    ),
    "no normal": (
        lambda p: _with_arrays(p, normal=None),
        r"has no normal/\.zarray; it has: .*color",
    ),
    "another size": (
        lambda p: zarr_zip(p, {k: _wider(v) for k, v in noisebase_arrays(1).items()}),
        r"frame0001\.zip is 17 x 12 pixels, the first .* 16 x 12",
    ),
    "fewer positions": (
        lambda p: _with_arrays(p, position=np.zeros((3, H, W, 2), np.float32)),
        r"position is of shape \(3, 12, 16, 2\), expected \(3, 12, 16, 6\)",
    ),
    "three exposures": (
        lambda p: _with_arrays(p, exposure=np.zeros(3, np.float32)),
        r"exposure is of shape \(3,\), expected \(2,\)",
    ),
    "a camera of two numbers": (
        lambda p: _with_arrays(p, camera_target=np.zeros(2, np.float32)),
        r"camera_target is of shape \(2,\), expected \(3,\)",
    ),
    "a crop": (
        lambda p: _with_arrays(p, position=np.roll(noisebase_arrays(1)["position"], 3, axis=2)),
        r"project \d+\.\d pixels away from their own pixels .* crop",
    ),
    "a pickle": (
        lambda p: _with_metadata(p, dtype="|O", filters=[{"id": "pickle"}]),
        r"without filters; it says.*pickle",
    ),
    "objects": (
        lambda p: _with_metadata(p, dtype="|O"),
        r"is of type object; only numbers are read",
    ),
    "a codec that unpickles": (
        lambda p: _with_metadata(p, compressor={"id": "pickle", "protocol": 5}),
        r"is packed by \{'id': 'pickle'.*read are: lz4, zstd, blosc",
    ),
    "zarr 3": (lambda p: _with_metadata(p, zarr_format=3), r"expected zarr format 2"),
    "a chunk that leaves": (
        lambda p: _with_metadata(p, dimension_separator="/../../"),
        r"expected zarr format 2",
    ),
    "a huge image": (
        lambda p: _with_metadata(p, shape=[4, 10**5, 10**5, 6], chunks=[4, 10**4, 10**4, 1]),
        r"claims to be 100000 x 100000 pixels",
    ),
    "a huge chunk": (
        lambda p: _with_metadata(p, chunks=[4, 10**5, 10**5, 4]),
        r"claims chunks of 160000000000 bytes",
    ),
    "very many chunks": (
        lambda p: _with_metadata(p, shape=[4, 10**3, 10**3, 6], chunks=[1, 1, 1, 1]),
        r"and 100000 chunks are read",
    ),
    "a bomb of the zip": (
        lambda p: _with_entry(p, CHUNK, bytes(10**7)),
        r"color/0\.0\.0\.0 unpacks to 10000000 bytes; at most",
    ),
    "a bomb of json": (
        lambda p: _with_entry(p, "color/.zarray", b" " * 10**7),
        r"color/\.zarray unpacks to 10000000 bytes; at most 65536",
    ),
    "a bomb of lz4": (
        lambda p: _with_entry(p, CHUNK, _lz4(10**6)),
        r"color/0\.0\.0\.0 cannot be unpacked \(destination buffer too small",
    ),
    "nonsense": (
        lambda p: _with_entry(p, "color/.zarray", json.dumps([1]).encode()),
        r"\.zarray cannot be understood",
    ),
}


def _wider(values: np.ndarray) -> np.ndarray:
    return np.repeat(values, [1] * (W - 1) + [2], axis=2) if values.ndim > 2 else values


@pytest.mark.parametrize("kind", BROKEN)
def test_an_archive_that_cannot_be_imported_is_explained(tmp_path, kind):
    break_it, message = BROKEN[kind]
    source = write_noisebase(tmp_path / "source")
    break_it(source / "corridor" / "frame0001.zip")
    with pytest.raises(SourceError, match=message):
        imported(source, "noisebase", tmp_path / "out")
    assert list(tmp_path.glob("out/*/clip.toml")) == []


def test_without_the_extra_the_message_says_what_to_install(tmp_path, monkeypatch):
    source = write_noisebase(tmp_path / "source")
    monkeypatch.setitem(sys.modules, "numcodecs", None)
    with pytest.raises(SourceError, match=r"needs numcodecs: pip install 'rlbench\[noisebase\]'"):
        imported(source, "noisebase", tmp_path / "out")
