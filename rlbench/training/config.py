"""Training configuration: number of frames, crops, precision and learning-rate schedule."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

__all__ = ["TrainingConfig"]

WARM_UP_FRACTION = 0.15  # of the frames, in which the learning rate rises
START_FACTOR, END_FACTOR = 1 / 25, 1e-4  # first and last learning rate, relative to the peak

DEFAULTS: dict[str, object] = {"spp": [], "mix": 0.0, "keep": "last"}  # not stored


@dataclass(frozen=True)
class TrainingConfig:
    """How a method is trained; use the same values for all methods that are compared."""

    frames: int = 12_000  # crops to train on; each frame of each clip in a batch counts
    batch: int = 1  # clips in a batch; on few frames, more steps are worth more
    crop: int = 128  # side of a crop, pixels
    sequence_length: int = 6  # frames
    ema_decay: float = 0.998  # of the averaged weights, which are validated and saved
    seed: int = 0
    max_grad_norm: float = 1.0  # longer gradients are scaled down to this L2 norm
    bf16: bool = False  # bfloat16 autocast of the forward pass
    eval_interval: int = 1_000  # frames between validations, and between checkpoints
    spp: tuple[float, ...] = ()  # training budgets; empty for those of the method's TrainingTask
    mix: float = 0.0  # share of crops from clips that are mixed in; 0 without such clips
    # weights that are saved: the last average, or that of the best validation by the mean over
    # the validation sets ("best") or by one of them ("best:NAME")
    keep: str = "last"

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> TrainingConfig:
        """The config in a stored dictionary, such as the JSON of a model card.

        Ignores keys that are no field.
        """
        names = {field.name for field in fields(cls)}
        values = {key: value for key, value in stored.items() if key in names}
        return cls(**values | {"spp": tuple(values.get("spp", ()))})

    def to_dict(self) -> dict[str, Any]:
        """The config as it is stored in JSON; `spp`, `mix` and `keep` only if they are chosen."""
        chosen = {"spp": list(self.spp), "mix": self.mix, "keep": self.keep}
        optional = {key: value for key, value in chosen.items() if value != DEFAULTS[key]}
        return {key: value for key, value in asdict(self).items() if key not in chosen} | optional

    @property
    def keeps_best(self) -> bool:
        """Are the weights of the best validation saved, instead of the last ones?"""
        return self.keep != "last"

    def lr_factor(self, frames_seen: int) -> float:
        """One-cycle learning rate after `frames_seen` frames, relative to the peak, in (0, 1].

        It rises by a half cosine, then falls by one (Smith and Topin 2018), as in torch's
        OneCycleLR with pct_start 0.15, div_factor 25, final_div_factor 400 (1e4 / 25). Kept as a
        pure function, because OneCycleLR has a state that a checkpoint would have to contain, and
        counts steps, whose number is not known in advance; a test compares the two.

        >>> config = TrainingConfig(frames=1000)
        >>> [config.lr_factor(frames) for frames in (0, 150, 1000)]
        [0.04, 1.0, 0.0001]
        """
        fraction = min(frames_seen / self.frames, 1.0)
        if fraction < WARM_UP_FRACTION:
            low, position = START_FACTOR, fraction / WARM_UP_FRACTION
        else:
            low, position = END_FACTOR, 1 - (fraction - WARM_UP_FRACTION) / (1 - WARM_UP_FRACTION)
        return low + (1.0 - low) * (1 - math.cos(math.pi * position)) / 2
