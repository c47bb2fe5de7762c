"""The weights that a training run starts from, and those that it writes with their card."""

from __future__ import annotations

import copy
import json
import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch
from safetensors.torch import load_file

from rlbench import weights
from rlbench.method import config_json
from rlbench.system import provenance
from rlbench.training.checkpoint import Progress, combine_digests
from rlbench.training.task import TrainingError, TrainingTask
from rlbench.training.train_state import TrainState

__all__ = ["frames_in_weights", "save_weights", "start_from"]

_logger = logging.getLogger(__name__)

MAX_DIGESTS = 32  # clips whose digests a card lists; more have one together


def frames_in_weights(file: Path) -> int | None:
    """The frames that a weights file was trained on; None if the file or its card is incomplete.

    A kill may leave weights without a card, or with that of older weights.
    """
    try:
        card = weights.read_card(file)
    except weights.WeightsError:
        return None
    return card.frames_seen if weights.digest(file) == card.sha256 else None


def start_from(task: TrainingTask, file: Path) -> TrainingTask:
    """The task, whose networks got the tensors of a weights file that have the name and shape.

    The others keep their values. The task records the origin for the model card (method, frames,
    hash and number of tensors), the names, and the frames that the weights were trained on; a
    warning lists the tensors. Raises WeightsError without a file and its card, and TrainingError if
    no tensor fits.
    """
    card, stored, initial = weights.read_card(file), load_file(file), task.networks.state_dict()
    taken = [
        name for name, t in stored.items() if name in initial and t.shape == initial[name].shape
    ]
    if not taken:
        raise TrainingError(
            f"no tensor of {file} ({card.name}) has the name and shape of one to train. Choose "
            "weights of a method with the same networks"
        )
    task.networks.load_state_dict({name: stored[name] for name in taken}, strict=False)
    count = f"{len(taken)} of {len(initial)} tensors"
    line = f"{count} from {file}: {', '.join(taken)}"
    if fresh := sorted(initial.keys() - set(taken)):
        line += f"; initial values: {', '.join(fresh)}"
    _logger.warning("start: %s", line)
    origin = (
        f"{card.name} after {card.frames_trained} frames, {weights.digest(file)[:12]} ({count})"
    )
    return replace(
        task,
        origin="; others: ".join(filter(None, (origin, task.origin))),
        pretrained=tuple(taken),
        frames_before=card.frames_trained,
    )


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
        frames_before=task.frames_before,
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
        trend=progress.trend,
        note="; ".join(filter(None, (remark, kept, progress.note(config.frames)))),
    )
    weights.save(networks, file, card)


def _describe_device(device: torch.device) -> str:
    machine = provenance.machine()
    if device.type == "cpu":
        return f"{machine.cpu}, {torch.get_num_threads()} threads"
    return machine.gpu
