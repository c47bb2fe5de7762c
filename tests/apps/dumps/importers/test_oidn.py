"""OIDN's training images: values, file names, and messages about sources that are not read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rlbench.errors import SourceError
from tests.apps.dumps.importers.sources import (
    H,
    W,
    exr,
    imported,
    pool,
    radiance,
    stored,
    write_oidn,
)


@pytest.fixture
def clip(tmp_path):
    return imported(write_oidn(tmp_path / "source"), "oidn", tmp_path / "out")


def test_samples_are_the_1_spp_images_and_a_single_reference_both_halves(clip):
    for index in range(3):
        expected = np.stack([radiance(index, seed) for seed in range(2)])
        np.testing.assert_array_equal(pool(clip, index), expected)
        reference = clip.frame(index).reference
        image = reference.half_a[0].permute(1, 2, 0).numpy()
        np.testing.assert_array_equal(image, radiance(index, 8) + np.float32(1 / 3))
        assert (reference.half_b == reference.half_a).all()


def test_albedo_is_that_of_the_first_sample_clipped(clip):
    expected = np.broadcast_to(np.float32([0.25, 0.5, 1]), (H, W, 3))
    np.testing.assert_array_equal(stored(clip, 0, "albedo"), expected)


def test_normals_are_unit_vectors_and_zero_stays_zero(clip):
    expected = np.broadcast_to(np.float32([0, -0.6, 0.8]), (H, W, 3)).copy()
    expected[0] = 0
    # half precision
    np.testing.assert_allclose(stored(clip, 0, "normal"), expected, atol=5e-4, rtol=0)


def test_the_header_lists_the_content_and_the_limitations(clip):
    header = clip.header
    assert (header.height, header.width, header.frames, header.pool_spp) == (H, W, 3, 2)
    assert header.buffers == ("albedo", "normal", "depth", "motion")
    assert header.reference_spp == (1024,) * 3
    assert header.limitations == ("halves", "normal", "no depth", "no motion")


def test_two_references_of_one_spp_are_two_halves(tmp_path):
    clip = imported(write_oidn(tmp_path / "source", halves=True), "oidn", tmp_path / "out")
    b = clip.frame(2).reference.half_b[0].permute(1, 2, 0).numpy()
    np.testing.assert_array_equal(b, radiance(2, 9) + np.float32(1 / 3))
    assert "halves" not in clip.header.limitations
    assert clip.header.reference_spp == (2048,) * 3


def test_the_spp_of_a_file_named_ref_is_unknown(tmp_path):
    source = write_oidn(tmp_path / "source", frames=1)
    exr(source / "walk_0000_ref.hdr.exr", radiance(0, 5))
    clip = imported(source, "oidn", tmp_path / "out")
    image = clip.frame(0).reference.half_a[0].permute(1, 2, 0).numpy()
    np.testing.assert_array_equal(image, radiance(0, 5))
    assert clip.header.reference_spp == (0,)


def test_frames_are_selected_by_their_numbers(tmp_path):
    clip = imported(write_oidn(tmp_path / "source"), "oidn", tmp_path / "out", frames=(1, 3))
    assert len(clip) == 2
    np.testing.assert_array_equal(pool(clip, 0)[0], radiance(1, 0))


def _drop(folder: Path, pattern: str) -> None:
    for path in list(folder.glob(pattern)):
        path.unlink()


def _swell(path: Path) -> None:
    """Claim 100000 x 100000 pixels in an EXR's header."""
    content = path.read_bytes()
    for window in (b"dataWindow", b"displayWindow"):
        at = content.index(window + b"\0box2i\0") + len(window) + 1 + 6 + 4
        content = content[: at + 8] + (99_999).to_bytes(4, "little") * 2 + content[at + 16 :]
    path.write_bytes(content)


ONE = "walk_0001_seed1_0001spp.hdr.exr"
BROKEN = {
    "a frame is missing": (
        lambda f: _drop(f, "walk_0001*"),
        r"clip 'walk': frames 0 to 2 are required and 1 of them are missing: 1;.*--frames",
    ),
    "no reference": (
        lambda f: _drop(f, "walk_0001*1024spp*"),
        r"clip 'walk', frame 1 has no reference.*_ref\.hdr\.exr.*it has: walk_0001_seed0",
    ),
    "no 1-spp image": (
        lambda f: [p.rename(str(p).replace("_0001spp", "_4spp")) for p in f.glob("*_0001spp*")],
        r"frame 0 has no image of 1 spp, and a mean of more cannot be separated",
    ),
    "only ldr": (
        lambda f: [p.rename(str(p).replace(".hdr", ".ldr")) for p in f.glob("*.hdr.exr")],
        r"holds nothing of layout 'oidn': expected files such as .*hdr\.exr",
    ),
    "no albedo in one frame": (
        lambda f: _drop(f, "walk_0001*.alb.exr"),
        r"clip 'walk', albedo: frames 0 to 2 are required and 1 of them are missing: 1",
    ),
    "another size": (
        lambda f: exr(f / ONE, np.zeros((H, W + 1, 3), np.float32)),
        r"walk_0001_seed1_0001spp\.hdr\.exr is 17 x 12 pixels, the first .* 16 x 12; all frames",
    ),
    "fewer samples": (
        lambda f: _drop(f, "walk_0001_seed1*"),
        r"frame 1 has 1 image of 1 spp, others up to 2; .*--samples 1",
    ),
    "no colours": (
        lambda f: exr(f / ONE, np.zeros((H, W, 3), np.float32), "YAB"),
        r"expected channels R, G, B or X, Y, Z; it has: A, B, Y",
    ),
    "truncated": (
        lambda f: (f / ONE).write_bytes((f / ONE).read_bytes()[:300]),
        r"0001spp\.hdr\.exr cannot be decoded, truncated or corrupt",
    ),
    "a bomb": (
        lambda f: _swell(f / ONE),
        r"claims to be 100000 x 100000 pixels; from 1 to 67108864 are read",
    ),
    "the same image twice": (
        lambda f: exr(f / ONE.replace("0001spp", "1"), radiance(1, 1)),
        r"are the same image of one frame",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_source_that_cannot_be_imported_is_explained(tmp_path, kind):
    break_it, message = BROKEN[kind]
    source = write_oidn(tmp_path / "source")
    break_it(source)
    with pytest.raises(SourceError, match=message):
        imported(source, "oidn", tmp_path / "out")
    assert list(tmp_path.glob("out/*/clip.toml")) == []
