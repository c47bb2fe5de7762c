"""What live sampling costs: a fixed part a frame, and a part for each path."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from rlbench.render.live import LivePool
from rlbench.render.record import named
from rlbench.render.trace import open_tracer
from rlbench.sampling import Samples

SIDE = 720
PATHS = (0.01, 0.1, 0.5, 1.0, 2.0)  # samples per pixel


@pytest.fixture(scope="module", params=["temple", "city", "hall", "ripples"])
def pool(request):
    tracer = open_tracer(named(request.param), SIDE, SIDE)
    return LivePool(tracer, 0.0, tuple(range(8)), 1, 1.0, np.float16, torch.device("cpu"))


@pytest.mark.parametrize("spp", PATHS)
def test_take_a_frame(benchmark, pool, spp):
    """A map of counts that no pixel order explains; what deciding on it costs is not counted."""
    random = np.random.default_rng(0)
    chosen = random.integers(0, SIDE * SIDE, round(spp * SIDE * SIDE))
    counts = np.minimum(np.bincount(chosen, minlength=SIDE * SIDE), 8).reshape(1, 1, SIDE, SIDE)
    wanted = torch.from_numpy(counts)
    nothing = pool.empty()
    radiance = benchmark.pedantic(pool.take, (nothing, wanted), rounds=5, warmup_rounds=1)
    benchmark.extra_info["million paths"] = int(wanted.sum()) / 1e6
    assert torch.equal(Samples(radiance, wanted).filled.any(1), wanted > 0)
    assert torch.isfinite(radiance).all()
