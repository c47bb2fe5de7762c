"""Checkpoint files: tensors, JSON metadata and a checksum of both in one safetensors file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
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
        progress = json.dumps(metadata)
        checksum = _checksum(progress, contiguous)
        save_file(contiguous, temporary, {"progress": progress, "checksum": checksum})


def read_metadata(path: Path) -> dict[str, Any]:
    """The metadata of a file that `write` wrote. Raises CheckpointError for any other file."""
    try:
        with safe_open(path, "pt") as file:
            metadata: dict[str, Any] = dict(json.loads(file.metadata()["progress"]))
            return metadata
    except (OSError, SafetensorError, TypeError, LookupError, ValueError, RecursionError) as error:
        raise CheckpointError(
            f"{path} is not a file written by a training run ({error!r}). Give a checkpoint "
            "from the folder of a run"
        ) from error


def read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The metadata and the tensors of a file that `write` wrote, under their present names.

    Raises CheckpointError for any other file, and for one that was changed. Older files have no
    checksum, so that a change of a number in them is not found.
    """
    metadata = read_metadata(path)
    with safe_open(path, "pt") as file:
        names = list(file.keys())  # safe_open objects are not iterable
        tensors = {name: file.get_tensor(name) for name in names}
        stored = file.metadata()
    if stored.get("checksum", checksum := _checksum(stored["progress"], tensors)) != checksum:
        raise CheckpointError(
            f"{path} was changed after it was written: its checksum is another one. Delete it and "
            "train again, or restore it from a copy"
        )
    return metadata, {_rename_prefix(name): tensor for name, tensor in tensors.items()}


def select_prefix(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors whose names start with `prefix`, with the prefix removed.

    >>> select_prefix("ema.", {"ema.bias": 1, "weights.bias": 2})
    {'bias': 1}
    """
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


def _checksum(progress: str, tensors: Mapping[str, Tensor]) -> str:
    """Hash of the metadata and of every name and bit of the tensors."""
    digest = sha256(progress.encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {list(tensor.shape)}".encode())
        digest.update(tensor.detach().cpu().reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def _rename_prefix(name: str) -> str:
    for old, new in RENAMED_PREFIXES.items():
        if name.startswith(old):
            return new + name.removeprefix(old)
    return name
