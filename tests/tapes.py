"""CUDA graphs, modelled on a processor: recorded operations run again on the same memory."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch.utils import _pytree as pytree
from torch.utils._python_dispatch import TorchDispatchMode


class Unasked(Tensor):
    """A tensor with values that nobody may ask for; results of its operations are such, too."""


def unasked(value: Any) -> Any:
    return value.clone().as_subclass(Unasked) if isinstance(value, Tensor) else value


class Tape(TorchDispatchMode):
    """Operations in order; each writes where it wrote at first, as in a CUDA graph."""

    def __init__(self) -> None:
        super().__init__()
        self.operations: list[tuple[Any, ...]] = []
        self.replays = 0
        self.created: set[int] = set()  # addresses of what the operations allocated
        self.before: dict[
            int, tuple[torch.UntypedStorage, torch.UntypedStorage]
        ] = {}  # what they overwrote, and its values

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        if torch.Tag.data_dependent_output in func.tags:
            raise RuntimeError(f"{func} asks for values")
        values = {a.name: v for a, v in zip(func._schema.arguments, args, strict=False)} | (
            kwargs or {}
        )
        for argument in func._schema.arguments:
            value = values.get(argument.name)
            if argument.alias_info is not None and argument.alias_info.is_write:
                for storage in map(Tensor.untyped_storage, tensors_of(value)):
                    if storage.data_ptr() not in self.created | self.before.keys():
                        self.before[storage.data_ptr()] = storage, storage.clone()
        result = func(*args, **(kwargs or {}))
        self.created |= addresses(result) - addresses((args, kwargs))  # views are of older memory
        self.operations.append((func, args, kwargs or {}, result))
        return result

    def undo(self) -> None:
        """Restore what was overwritten: a recording computes nothing."""
        for storage, values in self.before.values():
            storage.copy_(values)

    def replay(self) -> None:
        self.replays += 1
        # autocast has chosen the dtypes already
        with torch._C._AutoDispatchBelowAutograd(), torch.autocast("cpu", enabled=False):
            for function, args, kwargs, result in self.operations:
                again = function(*args, **kwargs)
                for old, new in zip(*map(tensors_of, (result, again)), strict=True):
                    if old.data_ptr() != new.data_ptr():  # no view and not in place
                        old.copy_(new)


def tensors_of(value: Any) -> list[Tensor]:
    return [each for each in pytree.tree_leaves(value) if isinstance(each, Tensor)]


def addresses(value: Any) -> set[int]:
    return {each.untyped_storage().data_ptr() for each in tensors_of(value)}


class Tapes:
    """A recorder on a processor."""

    def __init__(self) -> None:
        self.tapes: list[Tape] = []

    def hold(self, value: Tensor) -> Tensor:
        return value.detach().clone()

    def record(self, function):
        self.tapes.append(tape := Tape())
        with tape, patch("rlbench.ops.asking.is_recording", return_value=True):
            returned = function()
        tape.undo()
        return tape.replay, returned


def plain(value: Tensor) -> Tensor:
    return value.as_subclass(Tensor)
