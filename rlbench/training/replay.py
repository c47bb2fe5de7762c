"""Failed sequences: store the sequence that stopped a training run, and replay it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from rlbench import registry
from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import Clip, Frame, GBuffer, Reference, StoredPool
from rlbench.training import checkpoint
from rlbench.training.config import TrainingConfig
from rlbench.training.task import TrainingError
from rlbench.training.train_state import NonFiniteStep, NonFiniteStepError, TrainState

__all__ = ["FailedSequence", "replay_sequence", "write"]

RENAMED_KEYS = {  # in files written before these were renamed
    "name": "method",
    "draw": "index",
    "rate": "lr_factor",
    "done": "fraction_done",
    "found": "failure",
}
OLD_CONFIG_KEYS = ("seed", "norm", "average", "half")


@dataclass(frozen=True)
class FailedSequence:
    """The method and the arguments of the `TrainState.train_sequence` call that failed."""

    method: str
    clip: Clip
    index: int  # of the sequence in the run
    spp: float  # budget, samples per pixel
    lr_factor: float  # learning rate relative to the peak
    fraction_done: float  # of the run's frames


def write(
    folder: Path, state: TrainState, sequence: FailedSequence, failure: NonFiniteStep
) -> Path:
    """Store the clip and the tensors from before the sequence; returns the file.

    Radiance, G-buffer and reference are stored in float32, as they were used.
    """
    frames = list(sequence.clip)
    metadata = {key: value for key, value in vars(sequence).items() if key != "clip"} | {
        "config": state.config.to_dict(),
        "failure": failure._asdict(),
        "frames": [_frame_metadata(frame) for frame in frames],
    }
    tensors = dict(state.snapshot)
    for index, frame in enumerate(frames):
        tensors |= {f"clip.{index}.{k}": v.cpu() for k, v in _frame_tensors(frame).items()}
    file = folder / f"failed-sequence-{sequence.index}.safetensors"
    checkpoint.write(file, tensors, metadata)
    return file


def replay_sequence(file: Path | str, device: str = "cpu") -> NonFiniteStep | None:
    """Repeat the steps of a failed sequence, from the weights that it started with.

    Returns the failure, or None if all steps are finite this time, as may happen on another
    machine, with other code or in another precision. Raises CheckpointError for a file that no
    training run wrote, and TrainingError for a file without a failed sequence.
    """
    stored, tensors = checkpoint.read(Path(file))
    metadata = {RENAMED_KEYS.get(key, key): value for key, value in stored.items()}
    if "failure" not in metadata:
        raise TrainingError(
            f"{file} holds no failed sequence. Give the file named in the error message of the "
            "training run, failed-sequence-N.safetensors"
        )
    if "config" not in metadata:  # older files have some fields of the config beside the others
        metadata["config"] = {key: metadata[key] for key in OLD_CONFIG_KEYS}
    config = TrainingConfig.from_dict(metadata["config"])
    task = registry.training_task(metadata["method"], device, config.seed)
    state = TrainState(task, config, device)
    state.load_snapshot(tensors)
    clip = _read_clip(metadata, tensors, torch.device(device))
    arguments = (metadata["spp"], metadata["lr_factor"], metadata["fraction_done"])
    try:
        state.train_sequence(clip, *arguments)
    except NonFiniteStepError as error:
        return error.failure
    return None


def _frame_metadata(frame: Frame) -> dict[str, Any]:
    return {"index": frame.index, "keys": frame.pool.rounding_seeds, "static": frame.gbuffer.static}


def _frame_tensors(frame: Frame) -> dict[str, Tensor]:
    assert isinstance(frame.pool, StoredPool)
    gbuffer = {f"view.{name}": tensor for name, tensor in frame.gbuffer.buffers.items()}
    reference = {"a": frame.reference.half_a, "b": frame.reference.half_b}
    return gbuffer | reference | {"radiance": frame.pool.radiance}


def _read_clip(
    metadata: Mapping[str, Any], tensors: Mapping[str, Tensor], device: torch.device
) -> InMemoryClip:
    frames = [
        _read_frame(frame, checkpoint.select_prefix(f"clip.{index}.", tensors), device)
        for index, frame in enumerate(metadata["frames"])
    ]
    return InMemoryClip(f"sequence {metadata['index']}", "training", "", frames)


def _read_frame(
    metadata: Mapping[str, Any], stored: Mapping[str, Tensor], device: torch.device
) -> Frame:
    tensors = {name: tensor.to(device) for name, tensor in stored.items()}
    return Frame(
        metadata["index"],
        GBuffer(checkpoint.select_prefix("view.", tensors), metadata["static"]),
        StoredPool(tensors["radiance"], tuple(metadata["keys"])),
        Reference(tensors["a"], tensors["b"]),
    )
