"""Limits for untrusted files: folders and links."""

from __future__ import annotations

import tracemalloc
from contextlib import nullcontext

import pytest

from rlbench.apps.dumps.importers import formats, limits
from rlbench.apps.dumps.importers.zarr_v2 import open_archive, read_array
from rlbench.errors import SourceError
from tests.apps.dumps.importers.sources import H, W, noisebase_arrays, zarr_zip


def test_no_folder_is_an_error(tmp_path):
    with pytest.raises(SourceError, match="no folder .*nowhere"):
        formats.find_sequences(tmp_path / "nowhere", "oidn")


@pytest.mark.parametrize("format_", list(formats.FORMATS))
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_link_that_leaves_the_source_is_not_followed(tmp_path, format_, kind):
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "key").write_text("!")
    (tmp_path / "source").mkdir()
    target = tmp_path / "secret" / ("key" if kind == "file" else "")
    (tmp_path / "source" / "frame0000.zip").symlink_to(target)
    with pytest.raises(SourceError, match=r"frame0000\.zip is a link that leaves"):
        formats.find_sequences(tmp_path / "source", format_)


def test_a_link_inside_the_source_is_followed(source):
    (source / "walk_0003_seed0_0001spp.hdr.exr").symlink_to("walk_0000_seed0_0001spp.hdr.exr")
    assert formats.find_sequences(source, "oidn", (0, 3))[0].numbers == (0, 1, 2)


# Numbers of frames


def test_a_huge_range_of_frames_is_refused_at_once_and_a_small_one_beside_it_read(source):
    huge = "walk_9999999999_0001spp.hdr.exr"
    (source / huge).write_bytes((source / "walk_0000_seed0_0001spp.hdr.exr").read_bytes())
    for range_ in (None, (0, 10**10)):
        with pytest.raises(SourceError, match="a clip has at most 100000; .*--frames FIRST:END"):
            formats.find_sequences(source, "oidn", range_)
    assert formats.find_sequences(source, "oidn", (0, 2))[0].numbers == (0, 1)


# Zips that unpack to much more than they are


def _bomb(path, shape, chunks):
    """A Noisebase frame whose `color` is declared large and has no chunk."""
    metadata = {"shape": shape, "chunks": chunks, "compressor": None}
    zarr_zip(path, noisebase_arrays(0, 2), **metadata)
    return path


@pytest.mark.parametrize(
    ("shape", "chunks"),
    [
        ([4, 4096, 8192, 8], [4, 4096, 8192, 1]),  # 1 GiB in absent chunks
        ([4, H, W, 2], [4, 8192, 8192, 4]),  # 1 GiB in one chunk that exceeds the array
    ],
)
def test_a_small_zip_does_not_unpack_to_a_gigabyte(tmp_path, shape, chunks):
    path = _bomb(tmp_path / "frame0000.zip", shape, chunks)
    assert path.stat().st_size < 2**14
    tracemalloc.start()
    with (
        open_archive(path) as archive,
        pytest.raises(
            SourceError, match=r"unpacks to 1073741824 bytes, .* times the .* of the file"
        ),
    ):
        read_array(archive, "color")
    assert tracemalloc.get_traced_memory()[1] < 2**24
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("side", "message"),
    [(2**12, ""), (2**13, "nearly constant"), (2**13 + 1, "up to 67108864 pixels")],
)
def test_large_images_of_no_bytes_are_refused_and_small_ones_are_not(tmp_path, side, message):
    (tmp_path / "a.exr").write_bytes(b"x" * 1000)
    with pytest.raises(SourceError, match=message) if message else nullcontext():
        limits.check_clip("a", [tmp_path / "a.exr"], side, side)


def test_a_link_to_itself_is_named(tmp_path):
    (tmp_path / "loop.exr").symlink_to("loop.exr")
    with pytest.raises(SourceError, match="loop.exr is a link that leads to itself"):
        limits.list_files(tmp_path)
