"""Densities that no sensible method plans, but that sample allocation must turn into counts."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["DENSITIES", "Density"]

Density = Callable[[int, int], Float[Tensor, "1 1 h w"]]
DENORMAL = 1e-42  # 714 times the smallest float32 above 0
HUGE = 1e38  # its sum over an image is infinite in float32
SEED = 38


def _zero(h: int, w: int) -> Tensor:
    return torch.zeros(1, 1, h, w)


def _constant(h: int, w: int) -> Tensor:
    return torch.full((1, 1, h, w), 0.7)


def _one_hot(h: int, w: int) -> Tensor:
    density = torch.zeros(1, 1, h, w)
    density[..., h // 2, w // 2] = 1.0
    return density


def _half(h: int, w: int) -> Tensor:
    density = torch.zeros(1, 1, h, w)
    density[..., : (w + 1) // 2] = 1.0
    return density


def _random(h: int, w: int) -> Tensor:
    """Heavy-tailed: log-normal over about six decades."""
    return torch.randn(1, 1, h, w, generator=torch.Generator().manual_seed(SEED)).mul(3).exp()


def _denormal(h: int, w: int) -> Tensor:
    uniform = torch.rand(1, 1, h, w, generator=torch.Generator().manual_seed(SEED))
    return (uniform.double() * DENORMAL).float()


def _huge(h: int, w: int) -> Tensor:
    return torch.rand(1, 1, h, w, generator=torch.Generator().manual_seed(SEED)) * HUGE


def _denormal_and_huge(h: int, w: int) -> Tensor:
    """The ratio of two neighbours exceeds the range of float32."""
    rows, columns = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    return torch.where((rows + columns) % 2 == 0, DENORMAL, HUGE)[None, None]


DENSITIES: dict[str, Density] = {
    "zero": _zero,
    "constant": _constant,
    "one-hot": _one_hot,
    "half": _half,
    "random": _random,
    "denormal": _denormal,
    "1e38": _huge,
    "denormal-1e38": _denormal_and_huge,
}
