"""The result of a training run: a weights file and its model card."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from pathlib import Path

import torch

from rlbench import weights
from rlbench.method import config_json
from rlbench.system import provenance
from rlbench.training.progress import Progress, combine_digests
from rlbench.training.train_state import TrainState

__all__ = ["frames_in_weights", "save_weights", "weights_path"]

MAX_DIGESTS = 32  # clips whose digests a card lists; more have one together


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
    validation: Mapping[str, str] | None = None,
) -> None:
    """Write the kept averaged weights and their model card, whose note begins with the remark.

    `validation` describes the clips of each validation set, for the card.
    """
    task, config = state.task, state.config
    extra = {"spp": config.spp or task.spp, "max_lr": task.max_lr, "validation": validation or {}}
    networks, kept_at, kept = state.ema_networks, progress.frames_seen, ""
    if state.best and progress.best:
        networks = copy.deepcopy(networks)
        networks.load_state_dict(state.best)
        kept_at, psnr = progress.best
        kept = (
            f"kept: {config.keep}, {psnr:.2f} dB after {kept_at} of {progress.frames_seen} frames"
        )
    data = progress.config["data"]
    card = weights.ModelCard(
        name=method,
        data=tuple(data if len(data) <= MAX_DIGESTS else (c.rpartition(" ")[0] for c in data)),
        data_digest=combine_digests(data) if len(data) > MAX_DIGESTS else "",
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
        curves={name: tuple(curve) for name, curve in progress.curves.items()},
        kept_at=kept_at,
        note="; ".join(filter(None, (remark, kept, progress.note(config.frames)))),
    )
    weights.save(networks, file, card)


def _describe_device(device: torch.device) -> str:
    machine = provenance.machine()
    if device.type == "cpu":
        return f"{machine.cpu}, {torch.get_num_threads()} threads"
    return machine.gpu
