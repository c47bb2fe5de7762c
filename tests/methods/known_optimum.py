"""A sampling problem whose best allocation is known: independent pixels of known deviation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

PRIOR = 0.5  # what is known of a pixel without a sample is worth half a sample


@dataclass(frozen=True)
class KnownOptimum:
    """Pixels whose squared error after n samples is sigma^2 / (n + 0.5), in expectation."""

    sigma: Tensor  # 1 1 h w

    def error(self, counts: Tensor) -> Tensor:
        """Expected squared error of each pixel."""
        return self.sigma.square() / (counts + PRIOR)

    def best(self, cost: int, cap: int) -> Tensor:
        """The best whole allocation: the `cost` largest gains; they fall with every sample."""
        n = torch.arange(cap)
        gains = self.sigma.flatten()[:, None].square() / ((n + PRIOR) * (n + 1 + PRIOR))
        chosen = gains.flatten().topk(cost).indices // cap
        return torch.bincount(chosen, minlength=self.sigma.numel()).view(self.sigma.shape)

    def score(self, counts: Tensor, cap: int) -> float:
        """Share of the optimal reduction of error: 0 for uniform sampling, 1 for the optimum."""
        cost = int(counts.sum())
        uniform = torch.full_like(counts, cost // self.sigma.numel())
        errors = [float(self.error(n).mean()) for n in (uniform, counts, self.best(cost, cap))]
        return (errors[0] - errors[1]) / (errors[0] - errors[2])
