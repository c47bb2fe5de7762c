"""Parts of the light add up to the denoised image, whatever they are called."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import rlbench
from rlbench.apps.dumps.denoising.files import find_noisy_sequences
from rlbench.apps.dumps.denoising.passes import Part, denoise_parts, find_passes
from rlbench.apps.dumps.denoising.shot import denoise_sequence
from rlbench.denoise import DenoiseError, NoisyFrame, denoise_frame
from rlbench.errors import SourceError
from rlbench.frames import GBuffer
from tests.apps.dumps.exr_files import read_image, read_parts, write_file

H, W = 40, 56
HALF_STEP = 2.0**-11  # relative error of one half number


def make_light(seed: int, shape=(1, 3, H, W)) -> torch.Tensor:
    light = torch.rand(shape, generator=torch.Generator().manual_seed(seed)) ** 4
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
    ids=["light groups", "divided by colour", "some light in no part", "a black part"],
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
    def make(seed):
        return make_light(seed)[0].movedim(0, -1).double().numpy()

    passes = {"DiffDir": make(1), "DiffCol": make(2), "GlossInd": make(3), "GlossCol": make(4)}
    write(tmp_path / "a.exr", dtype, {**passes, "Emit": make(5)})
    names = ["DiffDir", "GlossInd*GlossCol", "emit"]
    _, written = denoise(method, tmp_path, names)
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
