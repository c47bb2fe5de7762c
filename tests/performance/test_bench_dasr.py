"""Speed of DASR's edge filter against scipy: pytest --benchmark-only."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from scipy import ndimage

from baselines.dasr.train import laplacian_of_gaussian

WINDOW = {"mode": "constant", "radius": 5}


def by_scipy(image: torch.Tensor) -> torch.Tensor:
    planes = [
        ndimage.gaussian_laplace(ndimage.gaussian_filter(plane, 1.5, **WINDOW), 1.5, **WINDOW)
        for plane in image[0].numpy()
    ]
    return torch.stack([torch.from_numpy(plane) for plane in planes])[None]


FILTERS: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {
    "rlbench": laplacian_of_gaussian,
    "scipy": by_scipy,
}


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.benchmark(group="Laplacian of Gaussian of a Gaussian, 1x3x256x256")
def test_edges(benchmark, name):
    image = torch.rand(1, 3, 256, 256, generator=torch.Generator().manual_seed(0))
    filtered = benchmark.pedantic(FILTERS[name], args=(image,), rounds=5, warmup_rounds=1)
    torch.testing.assert_close(filtered, by_scipy(image), rtol=0, atol=1e-5)  # float32, 44 terms
