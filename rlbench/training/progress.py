"""The progress of a training run: frames seen, validation history, changes of the config."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any

from rlbench.system import documents
from rlbench.training.checkpoint import CheckpointError

__all__ = ["Progress", "combine_digests", "describe_changes"]

MAX_LISTED = 8  # clips in a message
PLATEAU_DB = 0.1  # a smaller rise between the last two validations counts as converged


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

    def note(self, frames: int) -> str:
        """What users of the weights should know: config changes, early stop, no convergence yet.

        `frames` is the intended length of the run. Empty if there is nothing to report.
        """
        return "; ".join(filter(None, (*self.config_changes, self._warn_if_too_short(frames))))

    def _warn_if_too_short(self, frames: int) -> str:
        if self.frames_seen < frames:
            return f"stopped at {self.frames_seen} of {frames} frames"
        if len(self.validation_history) < 2:
            return ""
        (before, previous), (_, last) = self.validation_history[-2:]
        if last - previous < PLATEAU_DB:
            return ""
        return f"not converged: validation rose by {last - previous:.2f} dB after {before} frames"


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
