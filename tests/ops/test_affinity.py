"""Affinity sums against unfolding, known answers and finite differences; memory use."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from scipy import ndimage
from torch import Tensor

from rlbench.ops import affinity
from rlbench.ops.affinity import affinity_sum, cross_affinity_sum
from tests.ops import unfolded_affinity
from tests.ops.tensors import LargestTensor, randn

SIZES = [(1, 1), (2, 7), (12, 12), (9, 30)]
WINDOWS = [(1, 1), (3, 1), (3, 4), (5, 2), (11, 1)]


def random_inputs(n: int, h: int, w: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Features, sharpness, features of the source, and the source."""
    sharpness = randn(n, 1, h, w, seed=1).square()
    return randn(n, 3, h, w), sharpness, randn(n, 3, h, w, seed=2), randn(n, 2, h, w, seed=3)


@pytest.mark.parametrize("name", ["affinity_sum", "cross_affinity_sum"])
@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize(("h", "w"), SIZES)
def test_sums_equal_unfolding(h: int, w: int, window: tuple[int, int], name: str) -> None:
    features, sharpness, others, source = (part.double() for part in random_inputs(2, h, w))
    parts = (features, sharpness, *([others] if name.startswith("cross") else []), source)
    total = getattr(affinity, name)(*parts, *window)
    expected = getattr(unfolded_affinity, name)(*parts, *window)
    torch.testing.assert_close(total, expected, rtol=1e-12, atol=1e-12)  # doubles, 121 taps


@pytest.mark.parametrize("strip", [1, 7, 50])
def test_the_length_of_strips_does_not_change_the_sum(
    strip: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    features, sharpness, _, source = (part.double() for part in random_inputs(2, 12, 12))
    at_once = affinity_sum(features, sharpness, source, 5, 2)
    monkeypatch.setattr(affinity, "STRIP_PIXELS", strip)
    total_sum = affinity_sum(features, sharpness, source, 5, 2)
    torch.testing.assert_close(total_sum, at_once, rtol=1e-12, atol=1e-12)  # doubles, another order


@pytest.mark.parametrize("dilation", [1, 2, 4])
def test_zero_sharpness_gives_a_dilated_box_filter(dilation: int) -> None:
    features, sharpness, _, source = random_inputs(1, 20, 23)
    footprint = torch.zeros(4 * dilation + 1, 4 * dilation + 1)
    footprint[::dilation, ::dilation] = 1
    box = ndimage.correlate(source[0, 0].numpy(), footprint.numpy(), mode="constant")
    total_sum = affinity_sum(features, torch.zeros_like(sharpness), source, 5, dilation)[0, 0]
    # float32 sums of 25 terms of order one
    torch.testing.assert_close(total_sum, torch.from_numpy(box) - source[0, 0], rtol=0, atol=1e-5)


@pytest.mark.parametrize("scale", [0.0, 1e18])
def test_features_of_any_size_give_finite_sums_and_gradients(scale: float) -> None:
    features, sharpness, source_features, source = random_inputs(1, 6, 6)
    parts = [(scale * features).requires_grad_(), sharpness.requires_grad_(), source]
    total = affinity_sum(*parts, 5) + cross_affinity_sum(
        *parts[:2], scale * source_features, source, 5
    )
    total.sum().backward()
    assert torch.isfinite(total).all()
    assert torch.isfinite(parts[0].grad).all()
    assert torch.isfinite(parts[1].grad).all()


@pytest.mark.parametrize("dilation", [1, 2])
def test_gradients_agree_with_finite_differences(dilation: int) -> None:
    parts = tuple(part.double().requires_grad_() for part in random_inputs(2, 3, 5))
    features, sharpness, _, source = parts
    own = partial(affinity_sum, side=3, dilation=dilation)
    assert torch.autograd.gradcheck(own, (features, sharpness, source))
    assert torch.autograd.gradcheck(partial(cross_affinity_sum, side=3, dilation=dilation), parts)


@pytest.mark.parametrize("side", [5, 11])
def test_gradients_equal_those_of_unfolding(side: int) -> None:
    parts = [part.double().requires_grad_() for part in random_inputs(1, 12, 13)]
    grad = randn(1, 2, 12, 13, seed=4).double()
    fast = torch.autograd.grad(cross_affinity_sum(*parts, side), parts, grad)
    slow = torch.autograd.grad(unfolded_affinity.cross_affinity_sum(*parts, side), parts, grad)
    for total_sum, expected in zip(fast, slow, strict=True):
        torch.testing.assert_close(total_sum, expected, rtol=1e-10, atol=1e-10)  # doubles, 121 taps


def test_the_backward_pass_allows_a_source_without_gradient() -> None:
    features, sharpness, _, source = random_inputs(1, 3, 3)
    affinity_sum(features.requires_grad_(), sharpness, source, 3).sum().backward()
    assert features.grad.abs().sum() > 0


def test_no_tensor_is_larger_than_the_features_with_their_rows_joined() -> None:
    features, sharpness, _, source = random_inputs(1, 32, 32)
    features.requires_grad_()
    with LargestTensor() as largest:
        affinity_sum(features, sharpness, source, 11).sum().backward()
    assert largest.size <= 4 * 3 * 32 * 37  # floats of 3 channels; unfolding: 121 times as many


@pytest.mark.parametrize(("side", "dilation"), [(4, 1), (0, 1), (-1, 1), (3, 0)])
def test_windows_without_a_centre_are_an_error(side: int, dilation: int) -> None:
    features, sharpness, _, source = random_inputs(1, 3, 3)
    with pytest.raises(ValueError, match=f"not {side} and {dilation}"):
        affinity_sum(features, sharpness, source, side, dilation)
