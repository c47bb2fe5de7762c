"""The result of a training run: a weights file and its model card."""

from __future__ import annotations

import json
from pathlib import Path

import torch

from rlbench import weights
from rlbench.method import config_json
from rlbench.system import provenance
from rlbench.training.progress import Progress
from rlbench.training.train_state import TrainState

__all__ = ["frames_in_weights", "save_weights", "weights_path"]


def weights_path(method: str, out: Path) -> Path:
    """The weights file that a run of `method` writes to the folder `out`.

    >>> weights_path("ours/A1", Path("runs/ours-A1")).as_posix()
    'runs/ours-A1/A1.safetensors'
    """
    family, _, variant = method.partition("/")
    return out / f"{variant or family}.safetensors"


def frames_in_weights(file: Path) -> int | None:
    """The frames that a weights file was trained on; None if the file or its card is incomplete.

    A kill may leave weights without a card, or with that of older weights.
    """
    try:
        card = weights.read_card(file)
    except weights.WeightsError:
        return None
    return card.frames_seen if weights.digest(file) == card.sha256 else None


def save_weights(
    method: str,
    file: Path,
    state: TrainState,
    progress: Progress,
    command: str,
    remark: str = "",
) -> None:
    """Write the averaged weights and their model card, whose note begins with the remark."""
    task, config = state.task, state.config
    extra = {"spp": config.spp or task.spp, "max_lr": task.max_lr}
    card = weights.ModelCard(
        name=method,
        data=tuple(progress.config["data"]),
        frames_seen=progress.frames_seen,
        steps=progress.steps,
        seconds=round(progress.seconds),
        device=_describe_device(state.device),
        seed=config.seed,
        command=command,
        commit=provenance.commit(),
        training_config=json.dumps({**config.to_dict(), **extra}),
        method_config=config_json(task.method),
        origin=task.origin,
        validation_history=tuple(progress.validation_history),
        note="; ".join(filter(None, (remark, progress.note(config.frames)))),
    )
    weights.save(state.ema_networks, file, card)


def _describe_device(device: torch.device) -> str:
    machine = provenance.machine()
    if device.type == "cpu":
        return f"{machine.cpu}, {torch.get_num_threads()} threads"
    return machine.gpu
