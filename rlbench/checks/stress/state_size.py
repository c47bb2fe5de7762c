"""The size of a method's state: its bytes, and the largest value in its tensors."""

from __future__ import annotations

import gc
import io
import pickle
from typing import Any

from torch import Tensor, nn

from rlbench.method import State

__all__ = ["largest_value", "live_tensor_bytes", "state_bytes"]


class _TensorCollector(pickle.Pickler):
    """Pickles a nested value and keeps its tensors aside."""

    def __init__(self) -> None:
        self.stream = io.BytesIO()
        self.tensors: list[Tensor] = []
        super().__init__(self.stream)

    def persistent_id(self, obj: Any) -> int | None:
        """The position in `tensors` of a tensor; None, so that it is pickled, for all else."""
        if not isinstance(obj, Tensor):
            return None
        self.tensors.append(obj)
        return len(self.tensors) - 1


def state_bytes(state: State) -> int:
    """Bytes of all tensors in a state, and of everything else in it when pickled.

    Raises TypeError or pickle.PicklingError for a state that cannot be pickled.

    >>> import torch
    >>> state_bytes([torch.zeros(4)]) - state_bytes([torch.zeros(2)])
    8
    """
    collected = _collect(state)
    tensors = sum(tensor.numel() * tensor.element_size() for tensor in collected.tensors)
    return tensors + len(collected.stream.getvalue())


def largest_value(state: State) -> float:
    """The largest absolute value of all finite floats in a state, NaN where a tensor holds NaN.

    Infinity does not count, because it is the depth of the background.

    >>> import torch
    >>> largest_value({"a": torch.tensor([-3.0, torch.inf]), "b": torch.tensor([2.0])})
    3.0
    """
    floats = [t.float() for t in _collect(state).tensors if t.is_floating_point() and t.numel()]
    if any(bool(tensor.isnan().any()) for tensor in floats):
        return float("nan")
    return max((float(t.where(t.isfinite(), 0.0).abs().max()) for t in floats), default=0.0)


def live_tensor_bytes() -> int:
    """Bytes of all tensors that any Python object of the process refers to, on any device."""
    gc.collect()
    tensors = [thing for thing in gc.get_objects() if type(thing) in (Tensor, nn.Parameter)]
    storages = (tensor.untyped_storage() for tensor in tensors)
    return sum({storage.data_ptr(): storage.nbytes() for storage in storages}.values())


def _collect(state: State) -> _TensorCollector:
    collector = _TensorCollector()
    collector.dump(state)
    return collector
