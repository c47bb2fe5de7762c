"""Where a training stands."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

PLATEAU_DB = 0.1  # dB: a validation curve that rose by less between its last two points is flat


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

    def switch_config(self, plan: dict[str, Any]) -> None:
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
        if high - low < PLATEAU_DB:
            return ""
        return f"not yet flat: validation rose by {high - low:.2f} dB after {before} frames"
