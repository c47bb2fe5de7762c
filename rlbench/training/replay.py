"""A training that went out of bounds: the sequence that did it, kept so that it can be replayed."""

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
from rlbench.training.train_state import NonFiniteStep, NotFiniteError, TrainState


@dataclass(frozen=True)
class FailedSequence:
    """One sequence of a training: all that `Learner.sequence` takes, and whose it is."""

    name: str  # of the method
    clip: Clip
    draw: int  # its number
    spp: float  # budget
    rate: float  # learning rate, as a share of the peak
    done: float  # share of the training that was over


def write(
    folder: Path,
    learner: TrainState,
    plan: TrainingConfig,
    sequence: FailedSequence,
    found: NonFiniteStep,
) -> Path:
    """The file that `replay` reads: the clip, and the tensors that the sequence began with.

    Radiance, view and reference are stored as they were drawn, in float32. The checkpoint of the
    training is not touched.
    """
    told = {k: v for k, v in vars(sequence).items() if k != "clip"}
    told |= {"norm": plan.norm, "average": plan.average, "half": plan.half, "seed": plan.seed}
    frames = list(sequence.clip)
    told |= {"found": found._asdict(), "frames": [_keys(frame) for frame in frames]}
    tensors = dict(learner.before)
    for place, frame in enumerate(frames):
        tensors |= {f"clip.{place}.{k}": v.cpu() for k, v in _tensors(frame).items()}
    file = folder / f"halted-at-draw-{sequence.draw}.safetensors"
    checkpoint.write(file, tensors, told)
    return file


def replay(file: Path | str, device: str = "cpu") -> NonFiniteStep | None:
    """Take the steps of a halted sequence again, from the weights that it began with.

    Returns what is not finite, or None where all is: on another machine, with other code, or in
    another precision. Raises TrainingError for a file of another kind.
    """
    told, tensors = checkpoint.read(Path(file))
    if "found" not in told:
        raise TrainingError(
            f"{file} holds no halted sequence; a training that halts names the file it wrote"
        )
    trainer = registry.training_task(told["name"], device, told["seed"])
    learner = TrainState(trainer, told["norm"], told["average"], told["half"], device)
    checkpoint.unpack(tensors, learner.networks, learner.optimizer, trainer.aside)
    inside = checkpoint.under("clip.", tensors)
    frames = [
        _frame(keys, checkpoint.under(f"{place}.", inside), torch.device(device))
        for place, keys in enumerate(told["frames"])
    ]
    clip = InMemoryClip(f"draw {told['draw']}", "training", "", frames)
    try:
        learner.sequence(clip, told["spp"], told["rate"], told["done"])
    except NotFiniteError as error:
        return error.found
    return None


def _keys(frame: Frame) -> dict[str, Any]:
    return {"index": frame.index, "keys": frame.pool.rounding_seeds, "static": frame.gbuffer.static}


def _tensors(frame: Frame) -> dict[str, Tensor]:
    assert isinstance(frame.pool, StoredPool)
    gbuffer = {f"view.{name}": tensor for name, tensor in frame.gbuffer.buffers.items()}
    reference = {"a": frame.reference.half_a, "b": frame.reference.half_b}
    return gbuffer | reference | {"radiance": frame.pool.radiance}


def _frame(keys: Mapping[str, Any], stored: Mapping[str, Tensor], device: torch.device) -> Frame:
    on = {name: tensor.to(device) for name, tensor in stored.items()}
    return Frame(
        keys["index"],
        GBuffer(checkpoint.under("view.", on), keys["static"]),
        StoredPool(on["radiance"], tuple(keys["keys"])),
        Reference(on["a"], on["b"]),
    )
