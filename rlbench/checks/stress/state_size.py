"""The size of a method's state: its bytes, and the largest value in its tensors."""

from __future__ import annotations

import gc
import sys

from torch import Tensor, nn

from rlbench.checks.tensors import iterate_parts, iterate_tensors
from rlbench.method import State

__all__ = ["largest_value", "live_tensor_bytes", "state_bytes"]


def state_bytes(state: State) -> int:
    """Bytes of all tensors in a state, and of the Python objects that hold them.

    >>> import torch
    >>> state_bytes([torch.zeros(4)]) - state_bytes([torch.zeros(2)])
    8
    """
    return sum(
        part.numel() * part.element_size() if isinstance(part, Tensor) else sys.getsizeof(part)
        for part in iterate_parts(state)
    )


def largest_value(state: State) -> float:
    """The largest absolute value of all finite floats in a state, NaN where a tensor holds NaN.

    Infinity does not count, because it is the depth of the background.

    >>> import torch
    >>> largest_value({"a": torch.tensor([-3.0, torch.inf]), "b": torch.tensor([2.0])})
    3.0
    """
    floats = [part.float() for part in iterate_tensors(state) if part.is_floating_point()]
    if any(bool(tensor.isnan().any()) for tensor in floats):
        return float("nan")
    values = (tensor.where(tensor.isfinite(), 0.0).abs() for tensor in floats if tensor.numel())
    return max((float(value.max()) for value in values), default=0.0)


def live_tensor_bytes() -> int:
    """Bytes of all tensors that any Python object of the process refers to, on any device."""
    gc.collect()
    tensors = [thing for thing in gc.get_objects() if type(thing) in (Tensor, nn.Parameter)]
    storages = (tensor.untyped_storage() for tensor in tensors)
    return sum({storage.data_ptr(): storage.nbytes() for storage in storages}.values())
