"""Sample encodings: how a varying number of samples enters networks with fixed channels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from methods.ours.variants import SLOTS
from rlbench.frames import Samples
from rlbench.ops.transfer import log_forward

__all__ = ["MISSING", "SAMPLE_ENCODINGS", "SampleEncoding"]

MISSING = -1.0  # marks an empty sample slot, or a state without valid history


class SampleEncoding(Protocol):
    """Maps the samples of a frame to `channels` values per pixel."""

    @property
    def channels(self) -> int:
        """Values per pixel."""

    def encode(self, samples: Samples) -> Float[Tensor, "n c h w"]:
        """The samples in log transfer; MISSING where a pixel has none."""


@dataclass(frozen=True)
class SingleSamples:
    """Each sample in channels of its own; empty slots hold MISSING."""

    channels: int = 3 * SLOTS

    def encode(self, samples: Samples) -> Float[Tensor, "n c h w"]:
        """The samples in log transfer, slot after slot."""
        values = log_forward(samples.radiance).where(samples.valid_mask, MISSING)  # n s 3 h w
        empty = SLOTS - values.shape[1]
        return F.pad(values, (0,) * 7 + (empty,), value=MISSING).flatten(1, 2)


@dataclass(frozen=True)
class MeanSample:
    """The mean of the samples."""

    channels: int = 3

    def encode(self, samples: Samples) -> Float[Tensor, "n c h w"]:
        """The mean in log transfer; MISSING in a pixel without samples."""
        return log_forward(samples.mean).where(samples.counts > 0, MISSING)


@dataclass(frozen=True)
class MeanAndCount(MeanSample):
    """The mean of the samples and their number, as a share of SLOTS."""

    channels: int = 4

    def encode(self, samples: Samples) -> Float[Tensor, "n c h w"]:
        """The mean in log transfer, then the count."""
        return torch.cat((super().encode(samples), samples.counts / SLOTS), dim=1)


@dataclass(frozen=True)
class NoEncoding:
    """Nothing: the variant has no encoder."""

    channels: int = 0

    def encode(self, samples: Samples) -> Float[Tensor, "n 0 h w"]:
        """A tensor of zero channels."""
        n, _, _, h, w = samples.radiance.shape
        return samples.radiance.new_empty(n, 0, h, w)


SAMPLE_ENCODINGS: Mapping[str, SampleEncoding] = {
    "single": SingleSamples(),
    "mean": MeanSample(),
    "mean and count": MeanAndCount(),
    "none": NoEncoding(),
}
