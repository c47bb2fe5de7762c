"""The ways to read a motion buffer: signs, order of axes, scale and direction."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor

DIRECTIONS = {"to the previous frame": -1, "to the next frame": 1}  # frames to where it leads


@dataclass(frozen=True)
class MotionConvention:
    """One way to understand the two motion channels; without arguments it is format v1's."""

    swapped: bool = False  # y comes first
    signs: tuple[int, int] = (1, 1)  # of x and y
    scale: str = "pixels"
    direction: str = "to the previous frame"

    def pixels(self, motion: Float[Tensor, "n 2 h w"]) -> Float[Tensor, "n 2 h w"]:
        """The motion in pixels, x right and y down."""
        h, w = motion.shape[-2:]
        ordered = motion.flip(1) if self.swapped else motion
        factor = torch.tensor(self.signs) * torch.tensor(_scales(h, w)[self.scale])
        return ordered * factor.view(1, 2, 1, 1)

    def __str__(self) -> str:
        """Both channels in their order, and what they mean."""
        x, y = ("-" * (sign < 0) for sign in self.signs)
        axes = f"({y}y, {x}x)" if self.swapped else f"({x}x, {y}y)"
        return f"{axes} in {self.scale}, {self.direction}"


STORED = MotionConvention()
OPPOSITE = MotionConvention(False, (-1, -1), "pixels", "to the next frame")


def _scales(h: int, w: int) -> dict[str, tuple[float, float]]:
    return {
        "pixels": (1.0, 1.0),
        "half pixels": (0.5, 0.5),
        "twice pixels": (2.0, 2.0),
        "NDC (-1..1)": (w / 2, h / 2),
        "shares of the image (0..1)": (float(w), float(h)),
    }


def readings() -> list[MotionConvention]:
    """Every combination."""
    parts = product((False, True), product((1, -1), (1, -1)), _scales(1, 1), DIRECTIONS)
    return [MotionConvention(*part) for part in parts]
