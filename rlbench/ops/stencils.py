"""Square stencils of filters: as a list of taps, or as tensors that cover all of them at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["Stencil", "Tap", "atrous_stencil", "box_stencil"]

B3_SPLINE = (3 / 8, 1 / 4, 1 / 16)  # weight by distance from the centre, in steps


class Tap(NamedTuple):
    """A neighbour below or to the right; its opposite neighbour has the same weight."""

    down: int  # pixels
    right: int  # pixels
    weight: float  # relative to a centre weight of 1


@dataclass(frozen=True)
class Stencil:
    """A square of taps; the weight of each is that of its row times that of its column."""

    weights: tuple[float, ...]  # by distance from the centre, in steps; that of the centre is 1
    step: int = 1  # pixels between two taps

    @property
    def reach(self) -> int:
        """Steps from the centre to the border."""
        return len(self.weights) - 1

    @property
    def taps(self) -> list[Tap]:
        """One tap of each opposite pair, in reading order after the centre.

        >>> len(box_stencil(1).taps)  # of 8 neighbours
        4
        """
        square = [(y, x) for y in range(self.reach + 1) for x in range(-self.reach, self.reach + 1)]
        return [
            Tap(y * self.step, x * self.step, self.weights[y] * self.weights[abs(x)])
            for y, x in square
            if (y, x) > (0, 0)
        ]

    def squares(self, like: Tensor) -> tuple[Float[Tensor, "s s 1"], Float[Tensor, "s s 1"]]:
        """Weight and distance from the centre, in pixels, of every tap and of the centre.

        >>> weight, distance = atrous_stencil(2).squares(torch.zeros(1))
        >>> [round(float(each[0, 2]), 3) for each in (weight, distance)]  # four pixels above
        [0.167, 4.0]
        """
        steps = torch.arange(-self.reach, self.reach + 1, device=like.device, dtype=like.dtype)
        weight = torch.ones_like(steps)
        for distance, value in enumerate(self.weights):
            weight = torch.where(steps.abs() == distance, value, weight)
        down, right = steps[:, None, None], steps[None, :, None]
        return weight[:, None, None] * weight[None, :, None], self.step * torch.hypot(down, right)


def box_stencil(reach: int) -> Stencil:
    """A box filter of (2 reach + 1)^2 pixels, each of weight 1 like the centre."""
    return Stencil((1.0,) * (reach + 1))


def atrous_stencil(step: int) -> Stencil:
    """The 5 x 5 B3 spline, `step` pixels apart, relative to a centre weight of 1.

    The kernel of the à-trous wavelet transform (Dammertz et al. 2010; Schied et al. 2017): pass i
    uses step 2^i.

    >>> atrous_stencil(4).taps[0]
    Tap(down=0, right=4, weight=0.6666666666666666)
    """
    return Stencil(tuple(weight / B3_SPLINE[0] for weight in B3_SPLINE), step)
