"""Autoexposure against a loop; independence of brightness, noise and autocast."""

from __future__ import annotations

import math

import pytest
import torch

from rlbench.ops.color import luminance
from rlbench.ops.exposure import MIDDLE_GREY, autoexposure, log_average


def slow_autoexposure(image: torch.Tensor) -> float:
    """Exposure of one image [3 h w], tile by tile."""
    _, h, w = image.shape
    rows, columns = math.ceil(h / 16), math.ceil(w / 16)
    logs = []
    for i in range(rows):
        for j in range(columns):
            tile = image[
                :, i * h // rows : (i + 1) * h // rows, j * w // columns : (j + 1) * w // columns
            ]
            r, g, b = tile.double().mean((1, 2)).tolist()
            luminance = 0.212671 * r + 0.71516 * g + 0.072169 * b
            if luminance > 1e-8:
                logs.append(math.log2(luminance))
    return 0.18 / 2 ** (sum(logs) / len(logs)) if logs else 1.0


def random_images(h: int, w: int) -> torch.Tensor:
    """Two log-normal images, the second 100 times brighter, each with a black corner."""
    generator = torch.Generator().manual_seed(h + w)
    image = torch.randn(2, 3, h, w, generator=generator).exp()
    image[..., : h // 2, : w // 2] = 0
    return image * torch.tensor([1.0, 100.0]).view(2, 1, 1, 1)


@pytest.mark.parametrize("size", [(64, 64), (33, 50), (1, 1), (16, 17), (7, 100)])
def test_autoexposure_equals_a_loop(size):
    image = random_images(*size)
    expected = torch.tensor([slow_autoexposure(one) for one in image]).view(2, 1, 1, 1)
    torch.testing.assert_close(autoexposure(image), expected, rtol=1e-5, atol=0)


def test_a_grey_image_becomes_middle_grey():
    image = torch.full((1, 3, 20, 30), 0.5)
    assert float(autoexposure(image)) == pytest.approx(0.36, rel=1e-5)


def test_a_black_image_is_unchanged():
    assert float(autoexposure(torch.zeros(1, 3, 20, 30))) == 1.0


@pytest.mark.parametrize("gain", [2**-6, 0.3, 1e3])
def test_images_after_exposure_do_not_depend_on_brightness(gain):
    image = random_images(40, 40)
    expected = image * autoexposure(image)
    exposed = (gain * image) * autoexposure(gain * image)
    torch.testing.assert_close(exposed, expected, rtol=1e-5, atol=0)


def test_zero_mean_noise_hardly_changes_the_exposure():
    generator = torch.Generator().manual_seed(0)
    clean = torch.full((1, 3, 128, 128), 0.5)
    noisy = clean * torch.empty_like(clean).exponential_(generator=generator)
    # relative error of the mean of 256 pixels is at most 1/16, of 64 tiles 1/128
    assert float(autoexposure(noisy) / autoexposure(clean)) == pytest.approx(1, abs=0.02)


def test_autocast_does_not_change_the_exposure():
    image = torch.rand(2, 3, 40, 50, generator=torch.Generator().manual_seed(0))
    float32 = autoexposure(image)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(autoexposure(image), float32)


def test_unknown_pixels_count_in_no_tile():
    """Tiles are means of the known pixels; a tile without any is ignored."""
    image = random_images(40, 40)
    known = torch.rand(2, 1, 40, 40, generator=torch.Generator().manual_seed(0)) < 0.2
    known[..., :14, :14] = False  # the first tile
    expected = []
    for one, mask in zip(image, known, strict=True):
        bounds = [(i * 40 // 3, (i + 1) * 40 // 3) for i in range(3)]
        tiles = [(slice(*rows), slice(*columns)) for rows in bounds for columns in bounds]
        means = [one[:, *tile][:, mask[0][tile]].mean(1) for tile in tiles if mask[0][tile].any()]
        light = [float(mean @ torch.tensor([0.212671, 0.71516, 0.072169])) for mean in means]
        expected.append(0.18 / math.exp(sum(map(math.log, light)) / len(light)))
    measured = MIDDLE_GREY / log_average(luminance(image * known), known).flatten()
    torch.testing.assert_close(measured, torch.tensor(expected), rtol=1e-5, atol=0)
