"""RL_PATH_TRACING: radiance from PNGs, motion from grids, and files that are not safe."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from rlbench.errors import SourceError
from tests.apps.dumps.importers.sources import (
    DRIFT,
    H,
    W,
    display,
    grid,
    imported,
    pool,
    stored,
    write_rl_path_tracing,
)


@pytest.fixture
def clip(tmp_path):
    return imported(write_rl_path_tracing(tmp_path / "source"), "rl-path-tracing", tmp_path / "out")


def display_bytes(light: np.ndarray) -> np.ndarray:
    """Bytes of a PNG from linear light (sRGB, IEC 61966-2-1)."""
    curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * curve).astype(np.uint8)


def test_samples_have_the_display_values_of_their_png(clip):
    expected = np.stack([display(2, slot) for slot in range(8)])
    np.testing.assert_array_equal(display_bytes(pool(clip, 1)), expected)


def test_the_reference_has_the_display_values_of_its_png(clip):
    image = clip.frame(1).reference.half_a[0].permute(1, 2, 0).numpy()
    np.testing.assert_array_equal(display_bytes(image), display(2, 3))


def test_motion_is_blenders_vector_with_y_down(clip):
    expected = np.broadcast_to([DRIFT[0], -DRIFT[1]], (H, W, 2))
    # grids are float, of coordinates up to 1
    np.testing.assert_allclose(stored(clip, 1, "motion"), expected, atol=1e-5, rtol=0)


def test_motion_points_to_where_grid_sample_reads(clip):
    ramps = np.stack(np.meshgrid(np.arange(W), np.arange(H))).astype(np.float32)
    read = torch.nn.functional.grid_sample(
        torch.from_numpy(ramps)[None], grid(), align_corners=False
    )
    moved = read[0].permute(1, 2, 0).numpy() - ramps.transpose(1, 2, 0)
    inner = (slice(0, H - 1), slice(0, W - 2))  # where it reads nothing from beyond the border
    np.testing.assert_allclose(stored(clip, 2, "motion")[inner], moved[inner], atol=1e-5, rtol=0)


def test_a_first_frame_without_motion_is_a_limitation(clip):
    assert not stored(clip, 0, "motion").any()
    assert "first motion" in clip.header.limitations


def test_a_buffer_is_the_png_value(clip):
    for step, buffer in enumerate(("normal", "albedo", "depth")):  # half precision
        np.testing.assert_allclose(stored(clip, 1, buffer), (20 * step + 2) / 255, rtol=5e-4)


def test_the_header_lists_the_limitations_of_the_files(clip):
    buffers = {"albedo", "normal", "depth"}
    assert set(clip.header.limitations) == {
        *("halves", "independence", "linear", "first motion"),
        *buffers,
    }


def test_motion_files_may_have_the_name_that_the_script_writes(tmp_path):
    clip = imported(
        write_rl_path_tracing(tmp_path / "source", corr=""), "rl-path-tracing", tmp_path / "out"
    )
    assert stored(clip, 1, "motion")[0, 0, 0] == pytest.approx(DRIFT[0], abs=1e-5)


def test_a_source_without_motion_is_a_clip_with_zero_motion(tmp_path):
    source = write_rl_path_tracing(tmp_path / "source")
    for path in source.rglob("*.pt"):
        path.unlink()
    clip = imported(source, "rl-path-tracing", tmp_path / "out")
    assert not clip.header.static
    assert "no motion" in clip.header.limitations
    assert not stored(clip, 1, "motion").any()


def test_only_the_upper_left_720_are_kept(tmp_path):
    source = tmp_path / "emerald"
    source.mkdir()
    wide = np.zeros((722, 730, 3), np.uint8)
    wide[719, 719], wide[720:], wide[:, 720:] = 128, 255, 255
    for name in ("00-0000", "gd0000", f"add{'Denoising Albedo' * 2}0000"):
        Image.fromarray(wide).save(source / f"{name}.png")
    clip = imported(source, "rl-path-tracing", tmp_path / "out")
    assert stored(clip, 0, "albedo").shape == (720, 720, 3)
    assert display_bytes(pool(clip, 0)).max() == 128


# Sources that cannot be imported


class _Evil:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple:
        return (Path.touch, (self.mark,))


def _bomb(path: Path) -> None:
    """A tensor's file in which nothing but its size is wrong."""
    with zipfile.ZipFile(path) as archive:
        entries = {entry: archive.read(entry) for entry in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, content in entries.items():
            archive.writestr(entry, content if "data/0" not in entry else bytes(10**7))


def _swell(path: Path) -> None:
    """Claim 100000 x 100000 pixels in a PNG's header, with its checksum."""
    import zlib

    content = path.read_bytes()
    head = b"IHDR" + struct.pack(">II", 10**5, 10**5) + content[24:29]
    path.write_bytes(content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:])


def _motion(source: Path) -> Path:
    return source / "motions" / "0002corr.pt"


BROKEN = {
    "a pickle": (
        lambda s: torch.save(_Evil(s / "touched"), _motion(s)),
        r"0002corr\.pt is not a tensor of float32 that torch\.save wrote, and nothing else is",
    ),
    "a bomb of motion": (
        lambda s: _bomb(_motion(s)),
        r"unpacks to 1000\d* bytes, 1536 are expected",
    ),
    "a list": (lambda s: torch.save([1.0], _motion(s)), r"holds a list, expected a tensor"),
    "doubles": (lambda s: torch.save(grid().double(), _motion(s)), r"expected a tensor of float32"),
    "another shape": (
        lambda s: torch.save(grid()[:, :-1], _motion(s)),
        r"is of shape \(1, 11, 16, 2\), expected \(1, 12, 16, 2\)",
    ),
    "an endless view": (
        lambda s: torch.save(torch.zeros(1).expand(1, 10**6, 10**6, 2), _motion(s)),
        r"is of shape \(1, 1000000, 1000000, 2\)",
    ),
    "no zip": (lambda s: _motion(s).write_bytes(b"\x80\x04N."), r"is not a tensor .* BadZipFile"),
    "motion missing": (
        lambda s: _motion(s).unlink(),
        r"clip 'suntemple', motion: frames 2 to 3 are required and 1 of them are missing: 2;",
    ),
    "no reference": (
        lambda s: (s / "gd0002.png").unlink(),
        r"frame 2 has no reference gd0002\.png, so nothing can be scored",
    ),
    "a missing frame": (
        lambda s: [p.unlink() for p in s.glob("*0002.png")] and _motion(s).unlink(),
        r"clip 'suntemple': frames 1 to 3 .* missing: 2;",
    ),
    "a missing sample": (
        lambda s: (s / "05-0002.png").unlink(),
        r"frame 2 has 5 images of 1 spp, others up to 8; import as many of each with --samples 5",
    ),
    "another size": (
        lambda s: Image.new("RGB", (W, H + 1)).save(s / "03-0002.png"),
        r"03-0002\.png is 16 x 13 pixels, the first image of its sequence 16 x 12",
    ),
    "grey": (
        lambda s: Image.new("L", (W, H)).save(s / "03-0002.png"),
        r"03-0002\.png is a PNG of mode L, expected RGB",
    ),
    "no PNG": (
        lambda s: Image.new("RGB", (W, H)).save(s / "03-0002.png", format="JPEG"),
        r"03-0002\.png cannot be decoded",
    ),
    "a bomb of pixels": (
        lambda s: _swell(s / "03-0002.png"),
        r"03-0002\.png (claims to be 100000 x 100000|cannot be decoded.*decompression bomb)",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_files_that_cannot_be_imported_are_explained(tmp_path, kind):
    break_it, message = BROKEN[kind]
    source = write_rl_path_tracing(tmp_path / "source")
    break_it(source / "suntemple")
    with pytest.raises(SourceError, match=message):
        imported(source, "rl-path-tracing", tmp_path / "out")
    assert list(tmp_path.glob("out/*/clip.toml")) == []


def test_no_code_in_a_pickle_is_run(tmp_path):
    source = write_rl_path_tracing(tmp_path / "source") / "suntemple"
    torch.save(_Evil(source / "touched"), _motion(source))
    torch.load(_motion(source), weights_only=False)
    assert (source / "touched").exists()  # torch runs it if it is allowed to
    (source / "touched").unlink()
    with pytest.raises(SourceError):
        imported(source, "rl-path-tracing", tmp_path / "out")
    assert not (source / "touched").exists()
