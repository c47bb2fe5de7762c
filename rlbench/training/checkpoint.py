"""Checkpoint files: tensors and JSON metadata in one safetensors file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from rlbench.errors import RlbenchError
from rlbench.system import paths

__all__ = ["CheckpointError", "read", "read_metadata", "select_prefix", "write"]

RENAMED_PREFIXES = {  # of tensors in files written before these were renamed
    "average.": "ema.",
    "aside.": "auxiliary_network.",
}


class CheckpointError(RlbenchError, ValueError):
    """A file that is missing, or was not written by a training run."""


def write(path: Path, tensors: Mapping[str, Tensor], metadata: dict[str, Any]) -> None:
    """Write tensors and metadata to one file. A kill leaves the old file or the new one."""
    contiguous = {name: tensor.contiguous() for name, tensor in tensors.items()}
    with paths.atomic_write(path) as temporary:
        save_file(contiguous, temporary, {"progress": json.dumps(metadata)})


def read_metadata(path: Path) -> dict[str, Any]:
    """The metadata of a file that `write` wrote. Raises CheckpointError for any other file."""
    try:
        with safe_open(path, "pt") as file:
            metadata: dict[str, Any] = json.loads(file.metadata()["progress"])
            return metadata
    except (OSError, SafetensorError, TypeError, KeyError, ValueError) as error:
        raise CheckpointError(
            f"{path} is not a file written by a training run ({error!r}). Give a checkpoint or a "
            "failed sequence from the folder of a run"
        ) from error


def read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The metadata and the tensors of a file that `write` wrote, under their present names."""
    metadata = read_metadata(path)
    with safe_open(path, "pt") as file:
        names = list(file.keys())  # safe_open objects are not iterable
        return metadata, {_rename_prefix(name): file.get_tensor(name) for name in names}


def select_prefix(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors whose names start with `prefix`, with the prefix removed.

    >>> select_prefix("ema.", {"ema.bias": 1, "weights.bias": 2})
    {'bias': 1}
    """
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


def _rename_prefix(name: str) -> str:
    for old, new in RENAMED_PREFIXES.items():
        if name.startswith(old):
            return new + name.removeprefix(old)
    return name
