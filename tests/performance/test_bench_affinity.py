"""Affinity sums by shifting against affinity sums by unfolding, in the same run."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import pytest
import torch

from rlbench.ops import affinity
from tests.ops import unfolded_affinity


@pytest.mark.parametrize("op", [affinity, unfolded_affinity], ids=["shift", "unfold"])
@pytest.mark.parametrize(("size", "side"), [(128, 7), (128, 11), (256, 7)])
@pytest.mark.parametrize("name", ["affinity_sum", "cross_affinity_sum"])
def test_affinity_of_8_features(
    benchmark: Any, op: ModuleType, size: int, side: int, name: str
) -> None:
    """Forward and backward; not at 720x720, where unfolding needs 2 GB per tensor."""
    generator = torch.Generator().manual_seed(0)
    features, sharpness, source_features, source = (
        torch.rand(1, channels, size, size, generator=generator, requires_grad=True)
        for channels in (8, 1, 8, 4)
    )
    parts = [features, sharpness, source]
    if name == "cross_affinity_sum":
        parts.insert(2, source_features)
    benchmark.group = f"{name}, {side}x{side} taps, {size}x{size}"
    gradients = benchmark.pedantic(
        lambda: torch.autograd.grad(getattr(op, name)(*parts, side).sum(), parts),
        rounds=5,
        warmup_rounds=1,
    )
    assert all(torch.isfinite(gradient).all() for gradient in gradients)


@pytest.mark.benchmark(group="affinity sum at 720x720, forward")
@pytest.mark.parametrize("side", [7, 11])
def test_affinity_of_a_whole_frame(benchmark: Any, side: int) -> None:
    generator = torch.Generator().manual_seed(0)
    features, sharpness, source = (
        torch.rand(1, channels, 720, 720, generator=generator) for channels in (8, 1, 4)
    )
    total = benchmark.pedantic(
        lambda: affinity.affinity_sum(features, sharpness, source, side, 4),
        rounds=3,
        warmup_rounds=1,
    )
    assert torch.isfinite(total).all()
