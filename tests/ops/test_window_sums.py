"""Affinity and per-pixel kernels: unfolding, loops, known answers, differences, memory use."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
import torch
from scipy import ndimage
from torch import Tensor
from torch.nn import functional as F
from torch.utils._python_dispatch import TorchDispatchMode

from rlbench.ops import affinity
from rlbench.ops import kernels as kernels_module
from rlbench.ops.affinity import affinity_sum, cross_affinity_sum
from rlbench.ops.kernels import apply_kernels, splat_kernels

SIZES = [(1, 1), (2, 7), (12, 12), (9, 30)]
WINDOWS = [(1, 1), (3, 1), (3, 4), (5, 2), (11, 1)]


def randn(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


class LargestTensor(TorchDispatchMode):
    """Records the size of the largest tensor in bytes."""

    size = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        if isinstance(result, Tensor):
            self.size = max(self.size, result.untyped_storage().nbytes())
        return result


def unfold(image: Tensor, side: int, dilation: int) -> Tensor:
    """[n c taps h w] the values in the window of each pixel, zero beyond the border."""
    n, c, h, w = image.shape
    reach = side // 2 * dilation
    return F.unfold(image, side, dilation, reach).view(n, c, side * side, h, w)


def unfolded_cross_affinity_sum(
    features: Tensor,
    sharpness: Tensor,
    source_features: Tensor,
    source: Tensor,
    side: int,
    dilation: int = 1,
) -> Tensor:
    """As the operation of that name; zeros beyond the border of `source` add nothing."""
    distance = (features[:, :, None] - unfold(source_features, side, dilation)).square().sum(1)
    weights = torch.exp(-sharpness * distance)  # n taps h w
    return (weights[:, None] * unfold(source, side, dilation)).sum(2)


def random_inputs(n: int, h: int, w: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Features, sharpness, features of the source, and the source."""
    sharpness = randn(n, 1, h, w, seed=1).square()
    return randn(n, 3, h, w), sharpness, randn(n, 3, h, w, seed=2), randn(n, 2, h, w, seed=3)


@pytest.mark.parametrize("is_compiled", [False, True], ids=["taps", "windows"])
@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize(("h", "w"), SIZES)
def test_affinity_sums_equal_unfolding(
    h: int, w: int, window: tuple[int, int], is_compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(affinity, "is_compiling", lambda: is_compiled)
    features, sharpness, others, source = (part.double() for part in random_inputs(2, h, w))
    crossed = unfolded_cross_affinity_sum(features, sharpness, others, source, *window)
    # a pixel has distance zero to itself, so weight 1
    own = unfolded_cross_affinity_sum(features, sharpness, features, source, *window) - source
    totals = (
        cross_affinity_sum(features, sharpness, others, source, *window),
        affinity_sum(features, sharpness, source, *window),
    )
    torch.testing.assert_close(totals, (crossed, own), rtol=1e-12, atol=1e-12)  # doubles, 121 taps


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
def test_gradients_of_affinity_sums_agree_with_finite_differences(dilation: int) -> None:
    parts = tuple(part.double().requires_grad_() for part in random_inputs(2, 3, 5))
    features, sharpness, _, source = parts
    own = partial(affinity_sum, side=3, dilation=dilation)
    assert torch.autograd.gradcheck(own, (features, sharpness, source))
    assert torch.autograd.gradcheck(partial(cross_affinity_sum, side=3, dilation=dilation), parts)


@pytest.mark.parametrize("side", [5, 11])
def test_gradients_of_affinity_sums_equal_those_of_unfolding(side: int) -> None:
    parts = [part.double().requires_grad_() for part in random_inputs(1, 12, 13)]
    grad = randn(1, 2, 12, 13, seed=4).double()
    fast = torch.autograd.grad(cross_affinity_sum(*parts, side), parts, grad)
    slow = torch.autograd.grad(unfolded_cross_affinity_sum(*parts, side), parts, grad)
    torch.testing.assert_close(fast, slow, rtol=1e-10, atol=1e-10)  # doubles, 121 taps


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


# kernels


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
