"""A method and its clip in another precision, or on another device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from typing import Any

import torch
from torch import Tensor, nn

from rlbench.checks.frame_edits import edit_tensors, to_clip
from rlbench.clips.in_memory import InMemoryClip
from rlbench.method import Method

__all__ = ["convert_clip", "convert_method", "default_dtype", "thread_count"]


def convert_method(
    method: Method, dtype: torch.dtype | None = None, device: torch.device | None = None
) -> Method:
    """A copy of a method with all networks and float tensors in `dtype` and on `device`.

    They are found in the fields of the method and of its parts, at any depth. A device or a dtype
    in a field is replaced too.
    """
    copy = deepcopy(method)
    _convert_parts(copy, dtype, device, set())
    return copy


def convert_clip(
    clip: InMemoryClip, dtype: torch.dtype | None = None, device: torch.device | None = None
) -> InMemoryClip:
    """The clip with all tensors in `dtype` and on `device`."""
    return to_clip(
        edit_tensors(frame, lambda tensor: tensor.to(dtype=dtype, device=device)) for frame in clip
    )


@contextmanager
def default_dtype(dtype: torch.dtype) -> Iterator[None]:
    """New tensors have `dtype` unless they are created with another one."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


@contextmanager
def thread_count(threads: int) -> Iterator[None]:
    """Torch computes on the CPU with this number of threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _convert_parts(
    part: Any, dtype: torch.dtype | None, device: torch.device | None, visited: set[int]
) -> None:
    """Convert the fields of an object, of its parts, and the items of its containers."""
    if id(part) in visited or isinstance(part, str | bytes | type | Tensor):
        return
    visited.add(id(part))
    if isinstance(part, nn.Module):
        part.to(dtype=dtype, device=device)
    slots: Any = part if isinstance(part, dict | list) else getattr(part, "__dict__", {})
    for key, value in list(enumerate(slots) if isinstance(slots, list) else slots.items()):
        slots[key] = _converted(value, dtype, device)
    children = slots.values() if isinstance(slots, dict) else slots
    for child in part if isinstance(part, tuple) else children:
        _convert_parts(child, dtype, device, visited)


def _converted(value: Any, dtype: torch.dtype | None, device: torch.device | None) -> Any:
    """A float tensor in `dtype`, any tensor on `device`; a device replaced; else the value."""
    if isinstance(value, Tensor) and not isinstance(value, nn.Parameter):
        return value.to(device=device, dtype=dtype if value.is_floating_point() else None)
    if isinstance(value, torch.device) and device is not None:
        return device
    return value
