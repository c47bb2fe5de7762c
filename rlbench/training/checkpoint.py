"""What a run keeps and leaves: its progress, checkpoints with a checksum, and trained weights."""

from __future__ import annotations

import copy
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from rlbench import weights
from rlbench.errors import RlbenchError
from rlbench.method import config_json
from rlbench.system import documents, paths, provenance
from rlbench.training.task import TrainingConfig, TrainingError, TrainingTask

if TYPE_CHECKING:
    from rlbench.training.train_state import TrainState

_logger = logging.getLogger(__name__)

MAX_LISTED = 8  # clips in a message
MAX_DIGESTS = 32  # clips whose digests a card lists; more have one together
LAST_FIFTH = 0.8  # of a run ends it
PLATEAU_DB = 0.1  # a smaller rise in the last fifth of a run counts as converged


class CheckpointError(RlbenchError, ValueError):
    """A file that is missing, or was not written by a training run."""


@dataclass
class Progress:
    """Everything a resumed run needs besides the tensors of its checkpoint."""

    frames_seen: int = 0
    sequences: int = 0
    steps: int = 0  # of the optimiser
    seconds: float = 0.0
    frames_per_second: float = 0.0  # in the last sequence, without validation
    # pairs of frames seen and validation PSNR in dB, the mean over the validation sets
    validation_history: list[tuple[int, float]] = field(default_factory=list)
    # by validation set: frames seen, mean PSNR of all frames, and of the first frame of each clip
    curves: dict[str, list[tuple[int, float, float]]] = field(default_factory=dict)
    # by validation set: PSNR of the last quarter of its clips less that of the first, last time
    drift: dict[str, float] = field(default_factory=dict)
    # frames seen and validation PSNR at the ends of the cycles after which a further one began
    cycles: list[tuple[int, float]] = field(default_factory=list)
    best: tuple[int, float] | None = None  # frames seen and PSNR of the best validation, if kept
    config: dict[str, Any] = field(default_factory=dict)  # with the method and the training clips
    config_changes: list[str] = field(default_factory=list)

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> Progress:
        """The progress in a checkpoint's metadata.

        Raises CheckpointError for unknown fields and for values of another type.
        """
        try:
            if unknown := documents.unknown_keys(stored, cls):
                raise ValueError(f"unknown fields: {', '.join(unknown)}")
            return documents.decode(stored, cls)
        except ValueError as error:
            raise CheckpointError(
                f"the checkpoint has no progress of a training: {error}. Choose another --out"
            ) from error

    def switch_config(self, config: dict[str, Any]) -> None:
        """Continue with another config, and record what changed."""
        changes = describe_changes(self.config, config)
        self.config_changes += [f"after {self.frames_seen} frames: {change}" for change in changes]
        self.config = config

    @property
    def fraction_done(self) -> float:
        """The part of the training that is done, in [0, 1]: of its `frames`, or of `anneal`.

        With `until_flat`, of the cycles up to this one.
        """
        minutes = self.config.get("anneal", 0.0)
        done = self.seconds / (60 * minutes) if minutes else self.frames_seen / self._cycle_end
        return float(min(done, 1.0))

    @property
    def cycle_done(self) -> float:
        """The part of this cycle of the learning rate that is done, in [0, 1]."""
        if not self.cycles:
            return self.fraction_done
        start = self._cycle_end // 2
        return min(max(0.0, (self.frames_seen - start) / (self._cycle_end - start)), 1.0)

    @property
    def frames_goal(self) -> int:
        """Crops at the end of this cycle; an estimate where its length is given in minutes."""
        if self.config.get("anneal") and self.fraction_done > 0:
            return round(self.frames_seen / self.fraction_done)
        return self._cycle_end

    @property
    def _cycle_end(self) -> int:
        return int(self.config["frames"] << len(self.cycles))

    def begin_next_cycle(self) -> None:
        """At the end of a cycle, begin one that is as long as all before, if the run is to go on.

        It is to go on while each cycle gains at least `until_flat` over the one before (stochastic
        gradient descent with warm restarts, Loshchilov and Hutter 2017, with cycles that double).
        """
        least = self.config.get("until_flat", 0.0)
        most = self.config.get("most_frames", TrainingConfig.most_frames)
        is_over = not least or self.fraction_done < 1 or 2 * self._cycle_end > most
        if not is_over and (not self.cycles or self._last_rise >= least):
            self.cycles.append(self.validation_history[-1])

    @property
    def trend(self) -> str:
        """The validation in the last fifth of the run, or its last cycle: "rising" or "flat".

        Empty with fewer than two validations, and with fewer than two cycles.
        """
        least = self.config.get("until_flat", 0.0)
        if len(self.validation_history) < 2 or (least and not self.cycles):
            return ""
        return "rising" if self._last_rise >= (least or PLATEAU_DB) else "flat"

    @property
    def _last_rise(self) -> float:
        """Gain of the last validation, in dB: over the last cycle's end, if there are several.

        Otherwise over the last validation before the last fifth of the run.
        """
        if self.cycles:
            return self.validation_history[-1][1] - self.cycles[-1][1]
        *earlier, (frames, last) = self.validation_history
        before = [psnr for seen, psnr in earlier if seen <= LAST_FIFTH * frames] or [earlier[0][1]]
        return last - before[-1]

    @property
    def note(self) -> str:
        """What users of the weights should know: config changes, early stop, no convergence yet.

        Empty if there is nothing to report.
        """
        problem = ""
        if self.fraction_done < 1:
            problem = f"stopped at {self.frames_seen} of {self.frames_goal} frames"
        elif self.trend == "rising":
            part = "last cycle" if self.cycles else "last fifth"
            problem = f"not converged: validation rose by {self._last_rise:.2f} dB in the {part}"
        return "; ".join(filter(None, (*self.config_changes, problem)))


def describe_changes(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """The keys whose values differ, with both values; of many clips the number and one digest.

    >>> describe_changes({"crop": 64, "seed": 0}, {"crop": 128, "seed": 0})
    ['crop 64 -> 128']
    """
    keys = sorted(key for key in {**old, **new} if old.get(key) != new.get(key))
    return [f"{key} {_shorten(old.get(key))} -> {_shorten(new.get(key))}" for key in keys]


def combine_digests(clips: Sequence[str]) -> str:
    """One digest of clips, 12 hex digits, from the name and digest of each.

    >>> combine_digests(["city 0123", "hall 4567"])
    'c1bd31797d1e'
    """
    return sha256("\n".join(clips).encode()).hexdigest()[:12]


def _shorten(value: Any) -> Any:
    if isinstance(value, list) and len(value) > MAX_LISTED:
        return f"{len(value)} clips {combine_digests(value)}"
    return value


def write(path: Path, tensors: Mapping[str, Tensor], metadata: dict[str, Any]) -> None:
    """Write tensors and metadata to one file. A kill leaves the old file or the new one."""
    contiguous = {name: tensor.contiguous() for name, tensor in tensors.items()}
    with paths.atomic_write(path) as temporary:
        progress = json.dumps(metadata)
        checksum = _checksum(progress, contiguous)
        save_file(contiguous, temporary, {"progress": progress, "checksum": checksum})


def read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The metadata and the tensors of a file that `write` wrote.

    Raises CheckpointError for any other file, and for one that was changed.
    """
    try:
        with safe_open(path, "pt") as file:
            stored = file.metadata()
            metadata = dict(json.loads(stored["progress"]))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, TypeError, LookupError, ValueError, RecursionError) as error:
        raise CheckpointError(
            f"{path} is not a file written by a training run ({error!r}). Give a checkpoint "
            "from the folder of a run"
        ) from error
    if stored.get("checksum") != _checksum(stored["progress"], tensors):
        raise CheckpointError(
            f"{path} was changed after it was written: its checksum is another one. Delete it and "
            "train again, or restore it from a copy"
        )
    return metadata, tensors


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
    remark: str,
    validation: Mapping[str, str],
    further: Sequence[str] = (),
) -> None:
    """Write the kept averaged weights and their model card, whose note begins with the remark.

    `validation` describes the clips of each validation set, for the card; `further` are name and
    hash of the clips that were trained on beside the first ones.
    """
    task, config = state.task, state.config
    extra = {"spp": config.spp or task.spp, "max_lr": task.max_lr, "validation": validation}
    networks, kept_at, kept = state.average, progress.frames_seen, ""
    if state.best and progress.best:
        networks = copy.deepcopy(networks)
        networks.load_state_dict(state.best)
        kept_at, psnr = progress.best
        kept = (
            f"kept: {config.keep}, {psnr:.2f} dB after {kept_at} of {progress.frames_seen} frames"
        )
    data = [*progress.config["data"], *further]
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
        drift=progress.drift,
        kept_at=kept_at,
        trend=progress.trend,
        note="; ".join(filter(None, (remark, kept, progress.note))),
    )
    weights.save(networks, file, card)


def _describe_device(device: torch.device) -> str:
    machine = provenance.machine()
    if device.type == "cpu":
        return f"{machine.cpu}, {torch.get_num_threads()} threads"
    return machine.gpu
