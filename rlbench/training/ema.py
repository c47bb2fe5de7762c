"""The exponential moving average of the weights, as a function for torch's AveragedModel."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

__all__ = ["warmed_up_ema"]

Tensors = tuple[Tensor, ...] | list[Tensor]


def warmed_up_ema(decay: float) -> Callable[[Tensors, Tensors, Tensor | int], None]:
    """An exponential moving average for `AveragedModel`, faster during the first steps.

    In step n, from 1, the decay is min(decay, n / (n + 9)), as in TensorFlow's moving average
    with `num_updates` n - 1. Integer tensors, such as the counters of batch norm, are copied.
    """

    @torch.no_grad()
    def update(average: Tensors, current: Tensors, step: Tensor | int) -> None:
        n = int(step)
        if average[0].is_floating_point():  # tensors come grouped by dtype
            torch._foreach_lerp_(average, current, 1 - min(decay, n / (n + 9)))
        else:
            torch._foreach_copy_(average, current)

    return update
