"""Padding to a multiple and cropping back."""

from __future__ import annotations

import pytest
import torch

from rlbench.ops.padding import crop, pad


@pytest.mark.parametrize("size", [(16, 16), (1, 1), (17, 31), (33, 16), (5, 48)])
def test_cropping_undoes_padding(size):
    image = torch.rand(2, 3, *size)
    assert torch.equal(crop(pad(image, 16), *size), image)


@pytest.mark.parametrize(
    ("size", "padded"), [((16, 32), (16, 32)), ((1, 1), (16, 16)), ((17, 31), (32, 32))]
)
def test_padded_sides_are_the_next_multiples(size, padded):
    assert pad(torch.rand(1, 2, *size), 16).shape[-2:] == padded


def test_padding_replicates_the_border():
    padded = pad(torch.arange(6.0).view(1, 1, 2, 3), 4)
    expected = torch.tensor([[0.0, 1, 2, 2], [3, 4, 5, 5], [3, 4, 5, 5], [3, 4, 5, 5]])
    assert torch.equal(padded[0, 0], expected)
