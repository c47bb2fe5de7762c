"""Sources that are not imported: incomplete, contradictory, or unsafe; nothing is written."""

from __future__ import annotations

import struct
import sys
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from rlbench.apps.dumps.importers import formats, limits
from rlbench.apps.dumps.importers.zarr_v2 import open_archive, read_array
from rlbench.errors import SourceError
from tests.apps.dumps.exr_files import write_image
from tests.apps.dumps.importers.sources import (
    WRITERS,
    H,
    W,
    grid,
    import_clip,
    noisebase_arrays,
    radiance,
    write_noisebase,
    write_oidn,
    write_rl_path_tracing,
    zarr_zip,
)


def drop(pattern: str) -> Callable[[Path], object]:
    """Delete the files that match."""
    return lambda folder: [path.unlink() for path in folder.glob(pattern)]


def rename(old: str, new: str) -> Callable[[Path], object]:
    """Rename the files that have `old` in their names."""
    return lambda folder: [p.rename(str(p).replace(old, new)) for p in folder.glob(f"*{old}*")]


ONE = "walk_0001_seed1_0001spp.hdr.exr"
OIDN = {
    "a frame is missing": (drop("walk_0001*"), "'walk': frames 0 to 2 .* missing: 1;.*--frames"),
    "no reference": (drop("walk_0001*1024spp*"), "frame 1 has no reference.*it has: walk_0001_see"),
    "no 1-spp image": (rename("_0001spp", "_4spp"), "frame 0 has no image of 1 spp, and a mean"),
    "only ldr": (rename(".hdr", ".ldr"), "holds nothing of layout 'oidn': expected files such as"),
    "no albedo in one frame": (drop("walk_0001*.alb.exr"), "'walk', albedo: .* missing: 1"),
    "another size": (
        lambda f: write_image(f / ONE, np.zeros((H, W + 1, 3), np.float32)),
        "walk_0001_seed1_0001spp.hdr.exr is 17 x 12 pixels, the first .* 16 x 12",
    ),
    "fewer samples": (drop("walk_0001_seed1*"), "frame 1 has 1 image of 1 spp, .*--samples 1"),
    "the same image twice": (
        lambda f: write_image(f / ONE.replace("0001spp", "1"), radiance(1, 1)),
        "are the same image of one frame",
    ),
    "a clip": (lambda f: drop("*")(f) and (f / "clip.toml").touch(), "is a clip already"),
    "two clips of one name": (
        lambda f: write_oidn(f / "source", frames=1) and rename("walk_0", "source-walk_0")(f),
        "two clips named 'source-walk'; import .* separately",
    ),
}


def arrays(**changed: np.ndarray | None) -> Callable[[Path], object]:
    """Write a frame again with some arrays replaced or left out."""

    def write(path: Path) -> None:
        given = {**noisebase_arrays(1), **changed}
        zarr_zip(path, {key: value for key, value in given.items() if value is not None})

    return write


def metadata(**changed: object) -> Callable[[Path], object]:
    """Write a frame again with other metadata of "color"."""
    return lambda path: zarr_zip(path, noisebase_arrays(1), **changed)


def entry(name: str, content: bytes) -> Callable[[Path], object]:
    """Replace the entries whose names contain `name`; the zip itself compresses them."""

    def write(path: Path) -> None:
        with zipfile.ZipFile(path) as archive:
            entries = {each: archive.read(each) for each in archive.namelist()}
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for each, old in entries.items():
                archive.writestr(each, content if name in each else old)

    return write


CHUNK = "color/0.0.0.0"


def bomb_of_lz4(path: Path) -> None:
    from numcodecs import LZ4

    entry(CHUNK, bytes(LZ4().encode(bytes(10**6))))(path)


NOISEBASE = {
    "a frame is missing": (Path.unlink, "'corridor': .* missing: 1;"),
    "no zip": (lambda p: p.write_text("<html>"), "frame0001.zip cannot be read, truncated"),
    "no reference": (arrays(reference=None), "has no 'reference', so nothing can be scored"),
    "no normal": (arrays(normal=None), r"has no normal/\.zarray; it has: .*color"),
    "fewer positions": (
        arrays(position=np.zeros((3, H, W, 2), np.float32)),
        r"position is of shape \(3, 12, 16, 2\), expected \(3, 12, 16, 6\)",
    ),
    "three exposures": (arrays(exposure=np.zeros(3, np.float32)), "exposure is of shape .3,."),
    "a crop": (
        arrays(position=np.roll(noisebase_arrays(1)["position"], 3, axis=2)),
        r"project \d+\.\d pixels away from their own pixels .* crop",
    ),
    "a pickle": (
        metadata(dtype="|O", filters=[{"id": "pickle"}]),
        "without filters; it says.*pick",
    ),
    "objects": (metadata(dtype="|O"), "is of type object; only numbers are read"),
    "a codec that unpickles": (
        metadata(compressor={"id": "pickle", "protocol": 5}),
        "is packed by",
    ),
    "zarr 3": (metadata(zarr_format=3), "expected zarr format 2"),
    "a chunk that leaves": (metadata(dimension_separator="/../../"), "expected zarr format 2"),
    "a huge image": (
        metadata(shape=[4, 10**5, 10**5, 6], chunks=[4, 10**4, 10**4, 1]),
        "claims to be 100000 x 100000 pixels",
    ),
    "a huge chunk": (metadata(chunks=[4, 10**5, 10**5, 4]), "claims chunks of 160000000000 bytes"),
    "very many chunks": (
        metadata(shape=[4, 10**3, 10**3, 6], chunks=[1, 1, 1, 1]),
        "and 100000 chunks are read",
    ),
    "a bomb of the zip": (entry(CHUNK, bytes(10**7)), "unpacks to 10000000 bytes; at most"),
    "a bomb of json": (entry("color/.zarray", b" " * 10**7), "unpacks to 10000000.* most 65536"),
    "a bomb of lz4": (bomb_of_lz4, r"cannot be unpacked \(destination buffer too"),
}


class _Evil:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple:
        return (Path.touch, (self.mark,))


def tensor(value: object) -> Callable[[Path], object]:
    """Save something else as the motion of a frame."""
    return lambda scene: torch.save(value, motion_of(scene))


def motion_of(scene: Path) -> Path:
    return scene / "motions" / "0002corr.pt"


def sample(mode: str = "RGB", height: int = H, **options: str) -> Callable[[Path], object]:
    """Another image as a sample."""
    image = Image.new(mode, (W, height))
    return lambda scene: image.save(scene / "03-0002.png", **options)


def _swell(scene: Path) -> None:
    """Claim 100000 x 100000 pixels in a PNG's header, with its checksum."""
    path = scene / "03-0002.png"
    content = path.read_bytes()
    head = b"IHDR" + struct.pack(">II", 10**5, 10**5) + content[24:29]
    path.write_bytes(content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:])


RL = {
    "a pickle": (
        lambda s: torch.save(_Evil(s / "touched"), motion_of(s)),
        r"0002corr\.pt is not a tensor of float32 that torch\.save wrote, and nothing else is",
    ),
    "a bomb of motion": (
        lambda s: entry("data/0", bytes(10**7))(motion_of(s)),
        r"unpacks to 1000\d* bytes, 1536 are expected",
    ),
    "a list": (tensor([1.0]), "holds a list, expected a tensor"),
    "doubles": (tensor(grid().double()), "expected a tensor of float32"),
    "another shape": (tensor(grid()[:, :-1]), "is of shape .1, 11, 16, 2., expected .1, 12, 16, 2"),
    "an endless view": (
        tensor(torch.zeros(1).expand(1, 10**6, 10**6, 2)),
        r"is of shape \(1, 1000000, 1000000, 2\)",
    ),
    "motion missing": (drop("motions/0002*"), "motion: frames 2 to 3 are required .* missing: 2;"),
    "no reference": (drop("gd0002.png"), r"frame 2 has no reference gd0002\.png, so nothing can"),
    "a missing frame": (drop("**/*0002*"), "'suntemple': frames 1 to 3 .* missing: 2;"),
    "another size": (sample(height=H + 1), r"03-0002\.png is 16 x 13 pixels, the first image"),
    "grey": (sample("L"), r"03-0002\.png is a PNG of mode L, expected RGB"),
    "no PNG": (sample(format="JPEG"), r"03-0002\.png cannot be decoded"),
    "a bomb of pixels": (
        _swell,
        r"03-0002\.png (claims to be 100000 x 100000|cannot be decoded.*decompression bomb)",
    ),
}

PLACES = {  # what is broken: a folder or a file
    "oidn": (OIDN, "."),
    "noisebase": (NOISEBASE, "corridor/frame0001.zip"),
    "rl-path-tracing": (RL, "suntemple"),
}


@pytest.mark.parametrize(
    ("format_", "kind"), [(format_, kind) for format_, (each, _) in PLACES.items() for kind in each]
)
def test_a_source_that_cannot_be_imported_is_explained(tmp_path, format_, kind):
    source = WRITERS[format_](tmp_path / "source")
    table, place = PLACES[format_]
    break_it, message = table[kind]
    break_it(source / place)
    with pytest.raises(SourceError, match=message):
        import_clip(source, format_, tmp_path / "out")
    assert list(tmp_path.glob("out/*/clip.toml")) == []


def test_without_the_extra_the_message_says_what_to_install(tmp_path, monkeypatch):
    source = write_noisebase(tmp_path / "source")
    monkeypatch.setitem(sys.modules, "numcodecs", None)
    with pytest.raises(SourceError, match=r"needs numcodecs: pip install 'rlbench\[noisebase\]'"):
        import_clip(source, "noisebase", tmp_path / "out")


def test_no_code_in_a_pickle_is_run(tmp_path):
    source = write_rl_path_tracing(tmp_path / "source") / "suntemple"
    torch.save(_Evil(source / "touched"), motion_of(source))
    torch.load(motion_of(source), weights_only=False)
    assert (source / "touched").exists()  # torch runs it if it is allowed to
    (source / "touched").unlink()
    with pytest.raises(SourceError):
        import_clip(source, "rl-path-tracing", tmp_path / "out")
    assert not (source / "touched").exists()


@pytest.mark.parametrize(
    ("layout", "message"),
    [
        ("blend", r"no layout 'blend', .*; there are: blender, .*\. Did you mean 'blender'\?$"),
        ("noisebase", "expected files such as .*; it holds: walk_0000_seed0"),
    ],
)
def test_another_layout_is_reported_with_what_there_is(source, layout, message):
    with pytest.raises(SourceError, match=message):
        formats.find_sequences(source, layout)


# Folders and links


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


def test_a_link_inside_the_source_is_followed_but_not_to_itself(source):
    (source / "walk_0003_seed0_0001spp.hdr.exr").symlink_to("walk_0000_seed0_0001spp.hdr.exr")
    assert formats.find_sequences(source, "oidn", (0, 3))[0].numbers == (0, 1, 2)
    (source / "loop.exr").symlink_to("loop.exr")
    with pytest.raises(SourceError, match="loop.exr is a link that leads to itself"):
        limits.list_files(source)


# Sizes


def test_a_huge_range_of_frames_is_refused_at_once_and_a_small_one_beside_it_read(source):
    huge = "walk_9999999999_0001spp.hdr.exr"
    (source / huge).write_bytes((source / "walk_0000_seed0_0001spp.hdr.exr").read_bytes())
    for range_ in (None, (0, 10**10)):
        with pytest.raises(SourceError, match="a clip has at most 100000; .*--frames FIRST:END"):
            formats.find_sequences(source, "oidn", range_)
    assert formats.find_sequences(source, "oidn", (0, 2))[0].numbers == (0, 1)


@pytest.mark.parametrize(
    ("shape", "chunks"),
    [
        ([4, 4096, 8192, 8], [4, 4096, 8192, 1]),  # 1 GiB in absent chunks
        ([4, H, W, 2], [4, 8192, 8192, 4]),  # 1 GiB in one chunk that exceeds the array
    ],
)
def test_a_small_zip_does_not_unpack_to_a_gigabyte(tmp_path, shape, chunks):
    path = tmp_path / "frame0000.zip"
    zarr_zip(path, noisebase_arrays(0, 2), shape=shape, chunks=chunks, compressor=None)
    assert path.stat().st_size < 2**14
    tracemalloc.start()
    message = r"unpacks to 1073741824 bytes, .* times the .* of the file"
    with open_archive(path) as archive, pytest.raises(SourceError, match=message):
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
