"""Clips without noise or detail: black, constant, and sky alone."""

from __future__ import annotations

from collections.abc import Iterable

import torch

from rlbench.checks.frame_edits import edit_radiance, with_buffers
from rlbench.frames import Frame

__all__ = ["PLAIN_CLIPS", "black", "constant", "sky"]

GREY = 0.5  # radiance and albedo of the constant clip
WALL_DEPTH = 3.0  # metres
SKY_RADIANCE = (0.5, 0.7, 1.0)


def black(frames: Iterable[Frame]) -> list[Frame]:
    """The clip with all lights off."""
    return [edit_radiance(frame, torch.zeros_like) for frame in frames]


def constant(frames: Iterable[Frame]) -> list[Frame]:
    """A grey wall that fills the image, in even light, without noise."""
    return [_fill(frame, (GREY,) * 3, GREY, (0.0, -1.0, 0.0), WALL_DEPTH) for frame in frames]


def sky(frames: Iterable[Frame]) -> list[Frame]:
    """Background alone: no surface, and no noise."""
    return [_fill(frame, SKY_RADIANCE, 0.0, (0.0, 0.0, 0.0), torch.inf) for frame in frames]


def _fill(
    frame: Frame,
    radiance: tuple[float, float, float],
    albedo: float,
    normal: tuple[float, float, float],
    depth: float,
) -> Frame:
    """The frame with one value per channel everywhere, and no motion."""
    buffers = frame.gbuffer.buffers
    colour = buffers["albedo"].new_tensor(radiance).view(3, 1, 1)
    return with_buffers(
        edit_radiance(frame, lambda tensor: colour.expand_as(tensor).contiguous()),
        albedo=torch.full_like(buffers["albedo"], albedo),
        normal=torch.zeros_like(buffers["normal"]) + colour.new_tensor(normal).view(3, 1, 1),
        depth=torch.full_like(buffers["depth"], depth),
        motion=torch.zeros_like(buffers["motion"]),
    )


PLAIN_CLIPS = {"black": black, "constant": constant, "sky-only": sky}
