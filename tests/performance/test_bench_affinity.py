"""Sums over alike neighbours by shifting against the same by unfolding, in the same run."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import pytest
import torch

from rlbench.ops import affinity
from tests.ops import unfolded


@pytest.mark.parametrize("op", [affinity, unfolded], ids=["shift", "unfold"])
@pytest.mark.parametrize(("size", "side"), [(128, 7), (128, 11), (256, 7)])
@pytest.mark.parametrize("among", ["alike", "alike_in"])
def test_affinity_of_8_features(
    benchmark: Any, op: ModuleType, size: int, side: int, among: str
) -> None:
    """Forward and backward; 720x720 is left out, where unfolding takes 2 GB for each tensor."""
    generator = torch.Generator().manual_seed(0)
    features, sharpness, others, source = (
        torch.rand(1, channels, size, size, generator=generator, requires_grad=True)
        for channels in (8, 1, 8, 4)
    )
    parts = [features, sharpness, source]
    if among == "alike_in":
        parts.insert(2, others)
    benchmark.group = f"{among}, {side}x{side} taps, {size}x{size}"
    gradients = benchmark.pedantic(
        lambda: torch.autograd.grad(getattr(op, among)(*parts, side).sum(), parts),
        rounds=5,
        warmup_rounds=1,
    )
    assert all(torch.isfinite(gradient).all() for gradient in gradients)


@pytest.mark.benchmark(group="filter of 720x720, forward")
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
