"""Speed of the rank correlation against scipy's."""

from __future__ import annotations

import pytest
import torch
from scipy.stats import spearmanr

from metrics.effort import rank_correlation


@pytest.fixture
def counts_and_error():
    g = torch.Generator().manual_seed(0)
    return torch.randint(0, 9, (1, 1, 720, 720), generator=g), torch.rand(
        1, 1, 720, 720, generator=g
    )


@pytest.mark.benchmark(group="rank-correlation")
def test_rank_correlation(benchmark, counts_and_error):
    benchmark(rank_correlation, *counts_and_error)


@pytest.mark.benchmark(group="rank-correlation")
def test_rank_correlation_of_scipy(benchmark, counts_and_error):
    benchmark(spearmanr, *(x.flatten().numpy() for x in counts_and_error))
