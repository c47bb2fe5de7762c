"""Loose images and their buffers in other files, and parts of the light, whatever their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import rlbench
from rlbench.apps.dumps.denoising.files import GapError, find_noisy_sequences
from rlbench.apps.dumps.denoising.passes import Part, denoise_parts, find_passes
from rlbench.apps.dumps.denoising.shot import denoise_sequence
from rlbench.denoise import DenoiseError, NoisyFrame, denoise_frame
from rlbench.errors import SourceError
from rlbench.frames import GBuffer
from tests.apps.dumps.exr_files import read_image, read_parts, write_file, write_image

H, W = 40, 56
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


def tensor(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(image).movedim(-1, 0)[None]


@pytest.mark.parametrize("normal", ["normal.exr", "encoded.exr", "aovs.exr:N"])
@pytest.mark.parametrize("albedo", ["albedo.exr", "aovs.exr:albedo"])
def test_one_image_and_its_buffers_in_other_files(folder, albedo, normal):
    others = {"albedo": str(folder / albedo), "normal": str(folder / normal)}
    assert run(folder / "color.exr", folder / "out", others=others) == 1
    buffers = {"albedo": tensor(ALBEDO), "normal": tensor(NORMAL)}
    frame = NoisyFrame(GBuffer(buffers, static=True), tensor(COLOR), 8)
    image = denoise_frame(rlbench.load_method("oidn"), frame, None, 1.0).image
    expected = image[0].movedim(0, -1).numpy()
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
    names = [f"color.{number:04d}.exr" for number in (1, 11, 12)]
    assert sorted(path.name for path in (tmp_path / "out").glob("*.exr")) == names
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
    inside = ((0, 0), (W - 9, H - 5))
    corners = ((-4, -2), (W - 5, H - 3))
    denoised = []
    for name, display in (("all", corners), ("overscan", inside)):
        path = tmp_path / name / "a.exr"
        write_image(path, COLOR, dataWindow=corners, displayWindow=display)
        run(path, path.parent / "out")
        denoised.append(read_image(path.parent / "out" / "a.exr"))
    np.testing.assert_array_equal(*denoised)
    assert (denoised[0] != COLOR).any(-1).mean() > 0.99


# Parts of the light


HALF_STEP = 2.0**-11  # relative error of one half number


def make_light(seed: int) -> torch.Tensor:
    light = torch.rand((1, 3, H, W), generator=torch.Generator().manual_seed(seed)) ** 4
    light[..., :8, :8] = 0
    return light


@pytest.fixture
def method():
    return rlbench.load_method("oidn")


def make_frame(mean: torch.Tensor) -> NoisyFrame:
    buffers = {"albedo": torch.full_like(mean, 0.5), "normal": torch.zeros_like(mean)}
    return NoisyFrame(GBuffer(buffers, static=True), mean, 4)


ONE = torch.ones(1, 3, 1, 1)
COLOUR = make_light(3).clamp_max(1)


@pytest.mark.parametrize(
    ("parts", "rest"),
    [
        ({"key": Part(make_light(1), ONE), "fill": Part(make_light(2), ONE)}, 0),
        ({"diffuse": Part(make_light(1), COLOUR), "emission": Part(make_light(2), ONE)}, 0),
        ({"key": Part(make_light(1), ONE)}, 0.5),
        ({"black": Part(torch.zeros(1, 3, H, W), ONE), "key": Part(make_light(1), ONE)}, 0),
    ],
)
def test_parts_add_up_to_the_denoised_image(method, parts, rest):
    mean = sum(part.radiance for part in parts.values()) + rest
    found = denoise_parts(method, make_frame(mean), parts, {}, 1.0)
    image = denoise_frame(method, make_frame(mean), None, 1.0).image
    assert torch.equal(found.image, image)
    total = sum(found.lights[name] * part.colour for name, part in parts.items())
    assert all(light.isfinite().all() and (light >= 0).all() for light in found.lights.values())
    if rest:
        share = float(total.sum() / image.sum())  # each pixel of the rest is denoised light too
        assert share == pytest.approx(float((mean - rest).sum() / mean.sum()), rel=0.05)
        assert bool((total <= image * (1 + 1e-5)).all())
    else:
        torch.testing.assert_close(total, image.clamp_min(0), rtol=1e-5, atol=1e-7)


def test_a_part_that_is_clean_keeps_its_texture(method):
    """A part of constant light beside noise gets its own share, no fixed one of the image."""
    constant, noise = torch.full((1, 3, H, W), 0.5), make_light(5)
    parts = {"constant": Part(constant, ONE), "noise": Part(noise, ONE)}
    found = denoise_parts(method, make_frame(constant + noise), parts, {}, 1.0)
    fraction = found.image * constant / (constant + noise)
    error = (found.lights["constant"] - constant).square().mean()
    assert error < 0.1 * (fraction - constant).square().mean()


def test_parts_with_more_light_than_the_image_are_none(method):
    parts = {"key": Part(make_light(1), ONE), "same": Part(make_light(1), ONE)}
    with pytest.raises(DenoiseError, match=r"100% more light.*LIGHT\*COLOUR"):
        denoise_parts(method, make_frame(make_light(1)), parts, {}, 1.0)


def write(path: Path, dtype: type, passes: dict[str, np.ndarray]) -> None:
    """A file of one image with these passes, as Blender names them."""
    colours = {name: passes.get(f"{name[:-3]}Col", np.ones(3)) for name in passes}
    image = sum(p * colours[n] for n, p in passes.items() if not n.endswith("Col"))
    planes = {
        f"ViewLayer.{name}.{letter}": pixels[..., index].astype(dtype)
        for name, pixels in {**passes, "Combined": image}.items()
        for index, letter in enumerate("RGB")
    }
    write_file(path, {"": planes})


def read(path: Path, name: str) -> np.ndarray:
    return read_image(path, f"ViewLayer.{name}.").astype(np.float64)


def denoise(method, folder: Path, passes: list[str]):
    """The shot of a file with these passes, and the file that was written."""
    (shot,) = find_noisy_sequences(
        folder / "a.exr", passes=passes, needs_motion=False, has_memory=False
    )
    denoise_sequence(shot, method, "oidn", folder / "out")
    return shot, folder / "out" / "a.exr"


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_files_of_blender_add_up_within_half_rounding(method, tmp_path, dtype):
    names = ("DiffDir", "DiffCol", "GlossInd", "GlossCol", "Emit")
    light = [make_light(seed)[0].movedim(0, -1).double().numpy() for seed in range(5)]
    write(tmp_path / "a.exr", dtype, dict(zip(names, light, strict=True)))
    _, written = denoise(method, tmp_path, ["DiffDir", "GlossInd*GlossCol", "emit"])
    image = read(written, "Combined")
    assert not np.array_equal(image, read(tmp_path / "a.exr", "Combined"))
    total = read(written, "DiffDir") * read(written, "DiffCol")
    total += read(written, "GlossInd") * read(written, "GlossCol") + read(written, "Emit")
    # three rounded terms and the image; half numbers below 6e-5 have an absolute error of 3e-8
    np.testing.assert_allclose(total, image, rtol=4 * HALF_STEP, atol=2e-6)


def test_passes_may_be_in_parts_of_their_own(method, tmp_path):
    images = {"beauty": make_light(1) + make_light(2), "key": make_light(1), "fill": make_light(2)}
    parts = {
        name: dict(zip("RGB", image[0].numpy(), strict=True)) for name, image in images.items()
    }
    write_file(tmp_path / "a.exr", parts)
    shot, written = denoise(method, tmp_path, ["key", "fill"])
    for name, part in shot.read_parts(0).items():
        torch.testing.assert_close(part.light, images[name], rtol=0, atol=0)
    beauty, key, fill = (np.stack(list(planes.values())) for _, planes in read_parts(written))
    np.testing.assert_allclose(key + fill, beauty, rtol=1e-5, atol=1e-6)
    assert not np.array_equal(beauty, images["beauty"][0].numpy())


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["Difuse"], "no layer 'Difuse'.*ViewLayer.DiffDir"),
        (["DiffDir*DifCol"], "no layer 'DifCol'"),
        (["DiffDir", "DiffDir*DiffCol"], "twice"),
    ],
)
def test_a_pass_that_is_not_there_is_named(tmp_path, names, message):
    light = np.ones((H, W, 3))
    write(tmp_path / "a.exr", np.float32, {"DiffDir": light, "DiffCol": light})
    with pytest.raises(SourceError, match=message):
        find_passes(tmp_path / "a.exr", names)


@pytest.mark.parametrize(
    ("light", "colour"),
    [("DiffDir", "DiffCol"), ("Transmission Indirect", "Transmission Color"), ("Emit", None)],
)
def test_the_colour_of_a_pass_of_blender_is_found(tmp_path, light, colour):
    passes = {name: np.ones((H, W, 3)) for name in (light, colour) if name}
    write(tmp_path / "a.exr", np.float32, passes)
    (found,) = find_passes(tmp_path / "a.exr", [light])
    assert (found.colour is not None) == (colour is not None)
