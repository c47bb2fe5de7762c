"""Fingerprint a method on clip folders."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import torch

from rlbench import registry
from rlbench.checks.fingerprint.measure import Loss, measure_losses
from rlbench.clips.compatibility import incompatibility
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.stored import open_clip, read_header
from rlbench.errors import OptionError

__all__ = ["fingerprint_method"]


def fingerprint_method(
    name: str, folders: Sequence[Path], spp: float, frames: int, device: torch.device
) -> list[Loss]:
    """The losses of a method on the first frames of clips, with its shipped weights.

    Raises OptionError for a clip on which the method cannot run, or with too few frames.
    """
    method = registry.load_method(name, device)
    losses: list[Loss] = []
    for folder in folders:
        header, traits = read_header(folder), method.traits
        if reason := incompatibility(header, traits, spp):
            raise OptionError(f"{name} cannot run on clip '{header.name}': {reason}")
        clip = open_clip(folder, traits.inputs, pool=traits.pool, device=device)
        first = tuple(islice(clip, frames))
        shortened = InMemoryClip(clip.name, clip.scene, clip.digest, first)
        losses += measure_losses(name, method, shortened, spp)
    return losses
