"""How long a training is and on what, how its learning rate goes, and where it stands."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

WARM_UP = 0.15  # share of the training in which the learning rate rises
START, END = 1 / 25, 1e-4  # learning rate at the first and at the last step, of the peak
SETTLED = 0.1  # dB: a validation curve that rose by less between its last two points is flat


@dataclass(frozen=True)
class Plan:
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

    def rate(self, seen: int) -> float:
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


@dataclass
class Progress:
    """Where a training stands; all that a resumed one needs beside the tensors."""

    seen: int = 0  # frames
    draws: int = 0  # sequences
    steps: int = 0
    seconds: float = 0.0
    speed: float = 0.0  # frames a second in the last sequence, validation left out
    curve: list[tuple[int, float]] = field(default_factory=list)  # frames, validation PSNR
    plan: dict[str, Any] = field(default_factory=dict)  # that it follows
    changes: list[str] = field(default_factory=list)  # of the plan, made on the way

    def follow(self, plan: dict[str, Any]) -> None:
        """Go on by another plan, and write down what changes."""
        names = sorted(key for key in self.plan | plan if self.plan.get(key) != plan.get(key))
        for name in names:
            change = f"{name} {self.plan.get(name)} -> {plan.get(name)}"
            self.changes.append(f"after {self.seen} frames: {change}")
        self.plan = plan

    def note(self, frames: int) -> str:
        """What whoever uses the weights should know: changed on the way, cut short, too short?"""
        return "; ".join(filter(None, (*self.changes, self._rest(frames))))

    def _rest(self, frames: int) -> str:
        """Was it cut short of `frames`, or too short?"""
        if self.seen < frames:
            return f"stopped at {self.seen} of {frames} frames"
        if len(self.curve) < 2:
            return ""
        (before, low), (_, high) = self.curve[-2:]
        if high - low < SETTLED:
            return ""
        return f"not yet flat: validation rose by {high - low:.2f} dB after {before} frames"
