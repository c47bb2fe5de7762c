"""Conventions of a motion buffer: signs, order of the axes, scale and direction."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor

DIRECTIONS = {"to the previous frame": -1, "to the next frame": 1}  # offset of the other frame


@dataclass(frozen=True)
class MotionConvention:
    """One interpretation of the two motion channels; the default is that of clip format v1."""

    swapped: bool = False  # is y the first channel?
    signs: tuple[int, int] = (1, 1)  # of x and y
    scale: str = "pixels"
    direction: str = "to the previous frame"

    def to_pixels(self, motion: Float[Tensor, "n 2 h w"]) -> Float[Tensor, "n 2 h w"]:
        """The motion in pixels, x right and y down."""
        h, w = motion.shape[-2:]
        ordered = motion.flip(1) if self.swapped else motion
        factor = torch.tensor(self.signs) * torch.tensor(_scales(h, w)[self.scale])
        return ordered * factor.view(1, 2, 1, 1)

    def __str__(self) -> str:
        """Both channels in order, their scale and their direction.

        >>> print(MotionConvention(signs=(1, -1), scale="NDC (-1..1)"))
        (x, -y) in NDC (-1..1), to the previous frame
        """
        x, y = ("-" * (sign < 0) for sign in self.signs)
        axes = f"({y}y, {x}x)" if self.swapped else f"({x}x, {y}y)"
        return f"{axes} in {self.scale}, {self.direction}"


FORMAT_V1 = MotionConvention()
OPPOSITE = MotionConvention(False, (-1, -1), "pixels", "to the next frame")


def all_conventions() -> list[MotionConvention]:
    """Every combination of axis order, signs, scale and direction."""
    parts = product((False, True), product((1, -1), (1, -1)), _scales(1, 1), DIRECTIONS)
    return [MotionConvention(*part) for part in parts]


def _scales(h: int, w: int) -> dict[str, tuple[float, float]]:
    """Pixels per stored unit along x and y."""
    return {
        "pixels": (1.0, 1.0),
        "half pixels": (0.5, 0.5),
        "twice pixels": (2.0, 2.0),
        "NDC (-1..1)": (w / 2, h / 2),
        "UV (0..1)": (float(w), float(h)),
    }
