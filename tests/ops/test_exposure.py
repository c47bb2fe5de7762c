"""Autoexposure against a loop; independence of autocast."""

from __future__ import annotations

import math

import pytest
import torch

from rlbench.ops.color import luminance
from rlbench.ops.exposure import autoexposure, log_average


def slow_log_average(image: torch.Tensor, known: torch.Tensor) -> float:
    """The log-average of one image [3 h w], tile by tile, over the known pixels [h w]."""
    _, h, w = image.shape
    rows, columns = math.ceil(h / 16), math.ceil(w / 16)
    logs = []
    for i in range(rows):
        for j in range(columns):
            tile = (
                slice(i * h // rows, (i + 1) * h // rows),
                slice(j * w // columns, (j + 1) * w // columns),
            )
            r, g, b = image[:, *tile].double()[:, known[tile]].mean(1).tolist()
            light = 0.212671 * r + 0.71516 * g + 0.072169 * b
            if light > 1e-8:  # false for a tile without a known pixel
                logs.append(math.log2(light))
    return 2 ** (sum(logs) / len(logs))


def random_images(h: int, w: int) -> torch.Tensor:
    """Two log-normal images, the second 100 times brighter, each with a black corner."""
    generator = torch.Generator().manual_seed(h + w)
    image = torch.randn(2, 3, h, w, generator=generator).exp()
    image[..., : h // 2, : w // 2] = 0
    return image * torch.tensor([1.0, 100.0]).view(2, 1, 1, 1)


@pytest.mark.parametrize("share", [1.0, 0.2])
@pytest.mark.parametrize("size", [(64, 64), (33, 50), (1, 1), (16, 17), (7, 100)])
def test_the_log_average_equals_a_loop(size, share):
    """Tiles are means of the known pixels; a tile without any is ignored, as the first here."""
    image = random_images(*size)
    known = torch.rand(2, 1, *size, generator=torch.Generator().manual_seed(0)) < share
    known[..., -1, -1] = True
    if share < 1:
        known[..., : size[0] // 3, : size[1] // 3] = False
    expected = [slow_log_average(one, mask[0]) for one, mask in zip(image, known, strict=True)]
    measured = log_average(luminance(image * known), known).flatten()
    torch.testing.assert_close(measured, torch.tensor(expected), rtol=1e-5, atol=0)
    if share == 1:
        torch.testing.assert_close(autoexposure(image).flatten(), 0.18 / torch.tensor(expected))


def test_a_black_image_is_unchanged():
    assert float(autoexposure(torch.zeros(1, 3, 20, 30))) == 1.0


def test_autocast_does_not_change_the_exposure():
    image = torch.rand(2, 3, 40, 50, generator=torch.Generator().manual_seed(0))
    float32 = autoexposure(image)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(autoexposure(image), float32)
