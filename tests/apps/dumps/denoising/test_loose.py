"""Loose images: a noisy one and its buffers in other files, whatever their names are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import rlbench
from rlbench.apps.dumps.denoising.files import GapError, find_noisy_sequences
from rlbench.apps.dumps.denoising.shot import denoise_sequence
from rlbench.denoise import NoisyFrame, denoise_frame
from rlbench.errors import SourceError
from rlbench.frames import GBuffer
from tests.apps.dumps.exr_files import read_image, write_file, write_image

H, W = 24, 40
RNG = np.random.default_rng(4)
COLOR = RNG.random((H, W, 3)).astype(np.float32) ** 3
ALBEDO = RNG.random((H, W, 3)).astype(np.float32)
NORMAL = RNG.normal(size=(H, W, 3)).astype(np.float32)
NORMAL /= np.linalg.norm(NORMAL, axis=-1, keepdims=True)


def run(source: Path, out: Path, row: str = "oidn", **options) -> int:
    method = rlbench.load_method(row)
    has_memory, needs_motion = method.traits.temporal, "motion" in method.traits.inputs
    (shot,) = find_noisy_sequences(
        source, has_memory=has_memory, needs_motion=needs_motion, **options
    )
    return denoise_sequence(shot, method, row, out, exposure=1.0).written


def expect(color=COLOR, albedo=ALBEDO, normal=NORMAL) -> np.ndarray:
    """What the function makes of the arrays."""

    def convert(image):
        return torch.from_numpy(image).movedim(-1, 0)[None]

    buffers = {"albedo": convert(albedo), "normal": convert(normal)}
    frame = NoisyFrame(GBuffer(buffers, static=True), convert(color), 8)
    image = denoise_frame(rlbench.load_method("oidn"), frame, None, 1.0).image
    return image[0].movedim(0, -1).numpy()


@pytest.fixture
def folder(tmp_path) -> Path:
    write_image(tmp_path / "color.exr", COLOR)
    write_image(tmp_path / "albedo.exr", ALBEDO)
    write_image(tmp_path / "normal.exr", NORMAL, "XYZ")
    write_image(tmp_path / "encoded.exr", (NORMAL + 1) / 2)
    layers = {f"albedo.{c}": ALBEDO[..., k] for k, c in enumerate("RGB")}
    layers |= {f"N.{c}": NORMAL[..., k] for k, c in enumerate("XYZ")}
    write_file(tmp_path / "aovs.exr", {"": layers})
    return tmp_path


@pytest.mark.parametrize(
    ("albedo", "normal"),
    [
        ("albedo.exr", "normal.exr"),
        ("albedo.exr", "encoded.exr"),
        ("aovs.exr:albedo", "aovs.exr:N"),
    ],
)
def test_one_image_and_its_buffers_in_other_files(folder, albedo, normal):
    others = {"albedo": str(folder / albedo), "normal": str(folder / normal)}
    assert run(folder / "color.exr", folder / "out", others=others) == 1
    expected = expect()
    np.testing.assert_allclose(read_image(folder / "out" / "color.exr"), expected, atol=1e-5)
    run(folder / "color.exr", folder / "alone")
    assert np.abs(read_image(folder / "alone" / "color.exr") - expected).max() > 0.01


@pytest.mark.parametrize("pattern", ["color.####.exr", "color.%04d.exr", "color.{frame}.exr"])
def test_a_pattern_of_names_is_a_sequence_with_gaps(tmp_path, pattern):
    for number in (1, 11, 12):
        write_image(tmp_path / f"color.{number:04d}.exr", COLOR)
        write_image(tmp_path / f"albedo.{number:04d}.exr", ALBEDO)
    write_image(tmp_path / "unrelated.exr", ALBEDO)
    others = {"albedo": str(tmp_path / "albedo.####.exr")}
    assert run(tmp_path / pattern, tmp_path / "out", others=others) == 3
    assert {path.name for path in (tmp_path / "out").glob("*.exr")} == {
        f"color.{number:04d}.exr" for number in (1, 11, 12)
    }
    with pytest.raises(GapError, match="-m oidn"):
        run(tmp_path / pattern, tmp_path / "other", "accumulate/tuned", is_static=True)


def test_a_folder_of_one_image_a_frame_needs_no_layout(tmp_path):
    for number in (1, 2):
        write_image(tmp_path / f"{number:04d}.exr", COLOR)
    assert run(tmp_path, tmp_path / "out") == 2


@pytest.mark.parametrize(
    ("source", "others", "message"),
    [
        ("colour.exr", {}, "no file .*colour.exr"),
        ("color.exr", {"albedo": "albedo.###.exr"}, "no file"),
        ("color.exr", {"albedo": "color.exr:diffuse"}, "diffuse"),
        ("color.exr", {"normal": "."}, "are one frame"),
    ],
)
def test_what_cannot_be_matched_is_named(folder, source, others, message):
    others = {name: str(folder / each) for name, each in others.items()}
    with pytest.raises(SourceError, match=message):
        find_noisy_sequences(folder / source, others=others, needs_motion=False, has_memory=False)


def test_overscan_is_denoised(tmp_path):
    """Pixels outside the display window: as if the window were that of all pixels."""
    inside = ((4, 2), (W - 5, H - 3))
    corners = ((0, 0), (W - 1, H - 1))
    denoised = []
    for name, display in (("all", corners), ("overscan", inside)):
        path = tmp_path / name / "a.exr"
        write_image(path, COLOR, dataWindow=corners, displayWindow=display)
        run(path, path.parent / "out")
        denoised.append(read_image(path.parent / "out" / "a.exr"))
    np.testing.assert_array_equal(*denoised)
    assert (denoised[0] != COLOR).any(-1).mean() > 0.99
