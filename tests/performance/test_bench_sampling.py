"""Speed of sample allocation for a whole frame."""

from __future__ import annotations

import pytest
import torch

from rlbench.sampling import allocate_counts

SIDE = 720


@pytest.mark.parametrize("spp", [0.5, 2.0])
def test_allocate_counts(benchmark, spp):
    generator = torch.Generator().manual_seed(0)
    density = torch.rand(1, 1, SIDE, SIDE, generator=generator).pow(4)
    low = torch.zeros(1, 1, SIDE, SIDE, dtype=torch.int64)
    counts = benchmark(allocate_counts, density, round(spp * SIDE * SIDE), low, 8, (1,))
    assert int(counts.sum()) == round(spp * SIDE * SIDE)
