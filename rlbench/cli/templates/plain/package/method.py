"""Accumulate samples along the motion, and draw more of them where the history is short."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from rlbench import GBuffer, Samples, Size, Traits
from rlbench.ops import reproject_or_fill

from . import TRAITS

MAX_HISTORY = 32.0  # samples of a pixel that count; a change of light fades as fast


@dataclass(frozen=True)
class Accumulate:
    """The state [n 4 h w] holds the mean radiance of each pixel and its number of samples."""

    traits: Traits = TRAITS

    def start(self, size: Size) -> None:
        """Before the first frame, nothing is remembered."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: Tensor | None) -> Tensor:
        """The density [n 1 h w], at any scale: the fewer samples in the history, the larger."""
        _, count = _history(gbuffer, samples, state)
        return 1 / (1 + count)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """The mean of old and new samples, in linear radiance [n 3 h w], and the next state."""
        radiance, count = _history(gbuffer, samples, state)
        total = count + samples.counts
        image = (count * radiance + samples.counts * samples.mean) / total.clamp_min(1e-6)
        return image, torch.cat((image, total), dim=1)


def _history(gbuffer: GBuffer, samples: Samples, state: Tensor | None) -> tuple[Tensor, Tensor]:
    """Radiance [n 3 h w] and number of samples [n 1 h w] from the last frame, moved along."""
    if state is None:
        return torch.zeros_like(samples.mean), torch.zeros_like(samples.mean[:, :1])
    moved = reproject_or_fill(state, gbuffer.motion, 0.0)  # 0 where a pixel has just come into view
    return moved[:, :3], moved[:, 3:].clamp_max(MAX_HISTORY)


def build(variant: str, device: torch.device, weights: str | None) -> Accumulate:
    """The method; it has one variant and no weights."""
    return Accumulate()
