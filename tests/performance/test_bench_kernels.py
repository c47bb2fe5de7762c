"""Per-pixel kernels by shifting against per-pixel kernels by unfolding, in the same run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.kernels import apply_kernels


def unfolded(kernels: Tensor, image: Tensor) -> Tensor:
    n, c, h, w = image.shape
    padded = F.pad(image, (2, 2, 2, 2), mode="replicate")
    taps = F.unfold(padded, 5).view(n, c, 25, h, w)
    return (kernels[:, None] * taps).sum(2)


@pytest.mark.parametrize("apply", [apply_kernels, unfolded], ids=["shift", "unfold"])
@pytest.mark.parametrize("size", [128, 720])
@pytest.mark.benchmark(group="5x5 kernels, forward and backward")
def test_kernels_of_25_taps(
    benchmark: Any, apply: Callable[[Tensor, Tensor], Tensor], size: int
) -> None:
    generator = torch.Generator().manual_seed(0)
    kernels = torch.rand(1, 25, size, size, generator=generator, requires_grad=True)
    image = torch.rand(1, 4, size, size, generator=generator, requires_grad=True)
    benchmark.group = f"5x5 kernels, forward and backward, {size}x{size}"
    gradients = benchmark(
        lambda: torch.autograd.grad(apply(kernels, image).sum(), (kernels, image))
    )
    assert all(torch.isfinite(gradient).all() for gradient in gradients)
