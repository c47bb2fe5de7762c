"""Where a training stands, on disk: weights, their average, the optimiser, and the progress."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from rlbench.errors import RlbenchError
from rlbench.system import paths


class CheckpointError(RlbenchError, ValueError):
    """A file that is not there, or of another kind."""


def save(
    path: Path,
    networks: nn.Module,
    average: nn.Module,
    optimizer: torch.optim.Optimizer,
    progress: dict[str, Any],
    aside: nn.Module | None = None,
) -> None:
    """Write all of it to one file, at once: a kill leaves the old file or the new one."""
    tensors = state_tensors(networks, optimizer, aside)
    tensors |= {f"average.{k}": v for k, v in average.state_dict().items()}
    write(path, tensors, progress)


def load(
    path: Path,
    networks: nn.Module,
    average: nn.Module,
    optimizer: torch.optim.Optimizer,
    aside: nn.Module | None = None,
) -> dict[str, Any]:
    """Read it all back into place; returns the progress."""
    progress, tensors = read(path)
    unpack(tensors, networks, optimizer, aside)
    average.load_state_dict(under("average.", tensors))
    return progress


def state_tensors(
    networks: nn.Module, optimizer: torch.optim.Optimizer, aside: nn.Module | None
) -> dict[str, Tensor]:
    """All tensors that the next step depends on, by name; they are not copied."""
    tensors = {f"weights.{k}": v for k, v in networks.state_dict().items()}
    if aside is not None:
        tensors |= {f"aside.{k}": v for k, v in aside.state_dict().items()}
    for index, moments in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{index}.{k}": v for k, v in moments.items()}
    return tensors


def unpack(
    tensors: Mapping[str, Tensor],
    networks: nn.Module,
    optimizer: torch.optim.Optimizer,
    aside: nn.Module | None,
) -> None:
    """Put tensors of `packed` back into place."""
    networks.load_state_dict(under("weights.", tensors))
    if aside is not None:
        aside.load_state_dict(under("aside.", tensors))
    moments: dict[int, dict[str, Tensor]] = {}
    for key, value in under("optimizer.", tensors).items():
        index, name = key.split(".", 1)
        moments.setdefault(int(index), {})[name] = value
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": moments, "param_groups": groups})


def write(path: Path, tensors: Mapping[str, Tensor], told: dict[str, Any]) -> None:
    """A file of tensors with a few words, which is whole or not there."""
    whole = {k: v.contiguous() for k, v in tensors.items()}
    with paths.replacing(path) as temporary:
        save_file(whole, temporary, {"progress": json.dumps(told)})


def read_metadata(path: Path) -> dict[str, Any]:
    """The words of a file that `write` made. Raises CheckpointError for another one, or none."""
    try:
        with safe_open(path, "pt") as file:
            told: dict[str, Any] = json.loads(file.metadata()["progress"])
            return told
    except (OSError, SafetensorError, TypeError, KeyError, ValueError) as error:
        raise CheckpointError(f"{path} is no file that a training wrote: {error!r}") from error


def read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The words and the tensors of a file that `write` made."""
    told = read_metadata(path)
    with safe_open(path, "pt") as file:
        return told, {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118


def under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors whose names begin so, without that beginning."""
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
