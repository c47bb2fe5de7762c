"""Per-pixel kernels, gathered and splatted: loops, known answers, differences, memory use."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from torch import Tensor

from rlbench.ops import kernels as kernels_module
from rlbench.ops.kernels import apply_kernels, splat_kernels
from tests.ops.tensors import LargestTensor, randn


def slow_apply_kernels(kernels: Tensor, image: Tensor) -> Tensor:
    """Pixel by pixel, tap by tap, in double precision."""
    n, c, h, w = image.shape
    side = int(kernels.shape[1] ** 0.5)
    filtered = torch.zeros(n, c, h, w, dtype=torch.float64)
    for i in range(n):
        for y in range(h):
            for x in range(w):
                for tap in range(side * side):
                    v = min(max(y + tap // side - side // 2, 0), h - 1)
                    u = min(max(x + tap % side - side // 2, 0), w - 1)
                    weight = kernels[i, tap, y, x].double()
                    filtered[i, :, y, x] += weight * image[i, :, v, u].double()
    return filtered


@pytest.mark.parametrize("side", [1, 3, 5])
@pytest.mark.parametrize(("h", "w"), [(1, 1), (2, 7), (6, 5)])
def test_filtering_equals_a_loop(side: int, h: int, w: int) -> None:
    kernels, image = randn(2, side * side, h, w), randn(2, 3, h, w, seed=1)
    # float32 sums of at most 25 terms of order one
    torch.testing.assert_close(
        apply_kernels(kernels, image).double(),
        slow_apply_kernels(kernels, image),
        atol=1e-5,
        rtol=0,
    )


def test_a_huge_pixel_affects_its_window_alone() -> None:
    image = torch.zeros(1, 1, 11, 11)
    image[..., 5, 5] = 1e30
    touched = apply_kernels(torch.ones(1, 25, 11, 11), image) > 0
    assert int(touched.sum()) == 25


def test_the_backward_pass_allows_an_image_without_gradient() -> None:
    kernels = randn(1, 9, 3, 3).requires_grad_()
    apply_kernels(kernels, torch.ones(1, 2, 3, 3)).sum().backward()
    assert torch.equal(kernels.grad, torch.full_like(kernels, 2.0))


def test_no_tensor_is_larger_than_the_inputs() -> None:
    kernels, image = randn(1, 25, 32, 32), randn(1, 4, 32, 32)
    with LargestTensor() as largest:
        apply_kernels(kernels, image)
    assert largest.size <= 4 * kernels.numel()  # floats; unfolding: 4 times as many


def slow_splat(kernels: Tensor, image: Tensor, stride: int) -> Tensor:
    """Source pixel by source pixel, tap by tap, in double precision."""
    n, c, h, w = image.shape
    side = int(kernels.shape[1] ** 0.5)
    reach = (side - stride) // 2
    total = torch.zeros(n, c, stride * h, stride * w, dtype=torch.float64)
    for i in range(n):
        for y in range(h):
            for x in range(w):
                for tap in range(side * side):
                    v = mirror(stride * y + tap // side - reach, stride * h)
                    u = mirror(stride * x + tap % side - reach, stride * w)
                    weight = kernels[i, tap, y, x].double()
                    total[i, :, v, u] += weight * image[i, :, y, x].double()
    return total


def mirror(position: int, side: int) -> int:
    if position < 0:
        return -1 - position
    return position if position < side else 2 * side - 1 - position


@pytest.mark.parametrize(("side", "stride"), [(1, 1), (3, 1), (5, 1), (2, 2), (4, 2), (3, 3)])
@pytest.mark.parametrize(("h", "w"), [(2, 7), (6, 5)])
def test_splatting_equals_a_loop(side: int, stride: int, h: int, w: int) -> None:
    kernels, image = randn(2, side * side, h, w), randn(2, 3, h, w, seed=1)
    # float32 sums of at most 25 terms of order one
    torch.testing.assert_close(
        splat_kernels(kernels, image, stride).double(),
        slow_splat(kernels, image, stride),
        atol=1e-5,
        rtol=0,
    )


@pytest.mark.parametrize(("taps", "stride"), [(25, 1), (16, 2)])
def test_splatting_with_normalized_kernels_keeps_the_sum(taps: int, stride: int) -> None:
    kernels, image = (5 * randn(1, taps, 6, 9)).softmax(1), randn(1, 3, 6, 9, seed=1).abs()
    splatted = splat_kernels(kernels, image, stride)
    torch.testing.assert_close(splatted.sum((2, 3)), image.sum((2, 3)))


def test_splatting_is_the_transpose_of_gathering_inside_the_image() -> None:
    kernels, a, b = randn(1, 25, 9, 9), torch.zeros(1, 1, 9, 9), torch.zeros(1, 1, 9, 9)
    a[..., 2:7, 2:7], b[..., 2:7, 2:7] = randn(5, 5, seed=1), randn(5, 5, seed=2)
    gathered = (a * apply_kernels(kernels, b)).sum()
    torch.testing.assert_close(gathered, (splat_kernels(kernels, a) * b).sum())


@pytest.mark.parametrize(
    ("operation", "taps"),
    [(apply_kernels, 9), (splat_kernels, 9), (partial(splat_kernels, stride=2), 16)],
)
def test_gradients_agree_with_finite_differences(operation, taps: int) -> None:
    kernels = randn(2, taps, 3, 4).double().requires_grad_()
    image = randn(2, 2, 3, 4, seed=1).double().requires_grad_()
    assert torch.autograd.gradcheck(operation, (kernels, image))


@pytest.mark.parametrize(
    ("operation", "taps", "side", "words"),
    [(apply_kernels, taps, 3, f"not {taps}") for taps in (0, 4, 24)]
    + [
        (partial(splat_kernels, stride=stride), taps, 3, f"at stride {stride} .*, not {taps}")
        for taps, stride in ((0, 1), (16, 1), (24, 1), (25, 2), (1, 2))
    ]
    + [(splat_kernels, 25, 1, "reach 2 pixels beyond the border.*pad the image")],
)
def test_taps_that_do_not_fit_are_an_error(operation, taps: int, side: int, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        operation(torch.ones(1, taps, side, 4), torch.ones(1, 1, side, 4))


@pytest.mark.parametrize(("taps", "stride"), [(9, 1), (25, 1), (16, 2), (36, 2)])
def test_all_taps_at_once_as_on_a_gpu_equal_one_after_another(taps, stride, monkeypatch):
    results = []
    for few_steps in (False, True):
        monkeypatch.setattr(kernels_module, "_prefers_few_steps", lambda _, few=few_steps: few)
        generator = torch.Generator().manual_seed(0)
        shapes = (3, taps, 9, 11), (3, 2, 9, 11)
        kernels, image = (torch.rand(s, generator=generator).requires_grad_() for s in shapes)
        outputs = [splat_kernels(kernels, image, stride)]
        outputs += [apply_kernels(kernels, image)] if taps % 2 and stride == 1 else []
        sum((output * output.detach().sin()).sum() for output in outputs).backward()
        results.append([*outputs, kernels.grad, image.grad])
    for one, other in zip(*results, strict=True):
        torch.testing.assert_close(one, other)  # sums in another order
