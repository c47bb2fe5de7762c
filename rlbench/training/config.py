"""How long a training is and on what, how its learning rate goes, and where it stands."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

WARM_UP = 0.15  # share of the training in which the learning rate rises
START, END = 1 / 25, 1e-4  # learning rate at the first and at the last step, of the peak


@dataclass(frozen=True)
class TrainingConfig:
    """How long and on what; equal for all methods that are to be compared."""

    frames: int = 12_000  # crops to see, each frame of each clip in a batch counts
    batch: int = 1  # crops advanced together; on few frames, more steps are worth more
    crop: int = 128  # side of a crop, pixels
    length: int = 6  # frames of a sequence
    average: float = 0.998  # decay of the averaged weights, which are the ones shipped
    seed: int = 0
    norm: float = 1.0  # gradients are clipped to this length
    half: bool = False  # bfloat16 autocast of the forward pass
    every: int = 1_000  # frames between validations and checkpoints
    spp: tuple[float, ...] = ()  # budgets, one drawn a sequence; empty for those of the method

    def lr_factor(self, seen: int) -> float:
        """One-cycle learning rate after `seen` frames, as a share of the peak.

        It rises by a cosine, then falls by one.

        Smith and Topin 2018, as in torch's OneCycleLR with pct_start 0.15, div_factor 25,
        final_div_factor 400 (that is 1e4 / 25 from the start).
        """
        share = min(seen / self.frames, 1.0)
        if share < WARM_UP:
            low, high, along = START, 1.0, share / WARM_UP
        else:
            low, high, along = END, 1.0, 1 - (share - WARM_UP) / (1 - WARM_UP)
        return low + (high - low) * (1 - math.cos(math.pi * along)) / 2

    def told(self) -> dict[str, Any]:
        """The plan as JSON keeps it; budgets only where they are not the method's own."""
        budgets = {"spp": list(self.spp)} if self.spp else {}
        return {key: value for key, value in asdict(self).items() if key != "spp"} | budgets
