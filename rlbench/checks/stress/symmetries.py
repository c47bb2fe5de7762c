"""Symmetries of rendering: edits of a clip whose undone image must have the same error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from rlbench.checks.frame_edits import edit_radiance, edit_tensors, with_buffers
from rlbench.frames import Frame

__all__ = ["IDENTITY", "SYMMETRIES", "Symmetry"]

EXPOSURES = (1e-4, 1e-2, 1e2, 1e4)  # factors on radiance
CHANNELS = (1, 2, 0)  # red gets green, green blue, blue red


@dataclass(frozen=True)
class Symmetry:
    """An edit of frames, the inverse edit of images, and the remedy if it changes the error.

    `figure` is what counts of the dB lost: a gain by a mirror shows a preference as well.
    """

    edit: Callable[[Frame], Frame]
    undo: Callable[[Tensor], Tensor]
    remedy: str = ""
    figure: Callable[[float], float] = abs


def _expose(frame: Frame, factor: float) -> Frame:
    return edit_radiance(frame, lambda radiance: factor * radiance)


def _permute(frame: Frame) -> Frame:
    """Radiance and albedo with permuted channels."""
    permuted = edit_radiance(frame, lambda radiance: radiance[..., CHANNELS, :, :])
    return with_buffers(permuted, albedo=frame.gbuffer.albedo[:, CHANNELS])


def _flip(frame: Frame, image_dim: int, motion_channel: int, normal_channel: int) -> Frame:
    """The mirrored image, as a camera sees the world mirrored along one of its axes.

    World x is mirrored for left and right, world z for up and down, so normals and motion change
    sign along that axis.
    """
    flipped = edit_tensors(frame, lambda tensor: tensor.flip(image_dim))
    motion, normal = flipped.gbuffer.buffers["motion"].clone(), flipped.gbuffer.normal.clone()
    motion[:, motion_channel] *= -1
    normal[:, normal_channel] *= -1
    return with_buffers(flipped, motion=motion, normal=normal)


def _inverse_permute(image: Tensor) -> Tensor:
    inverse = [CHANNELS.index(channel) for channel in range(3)]
    return image[:, inverse]


def _divide(image: Tensor, factor: float) -> Tensor:
    return image / factor


IDENTITY = Symmetry(edit=lambda frame: frame, undo=lambda image: image)
SYMMETRIES = {
    f"exposure-{factor:.0e}": Symmetry(
        partial(_expose, factor=factor),
        partial(_divide, factor=factor),
        "divide radiance by an exposure before any constant, threshold or clamp, and multiply the "
        "image by it",
        figure=float,
    )
    for factor in EXPOSURES
}
SYMMETRIES |= {
    "channels-permuted": Symmetry(
        _permute, _inverse_permute, "permute colour channels at random in training"
    ),
    "flip-horizontal": Symmetry(
        partial(_flip, image_dim=-1, motion_channel=0, normal_channel=0),
        partial(torch.flip, dims=(-1,)),
        "flip training clips at random, with motion and normals",
    ),
    "flip-vertical": Symmetry(
        partial(_flip, image_dim=-2, motion_channel=1, normal_channel=2),
        partial(torch.flip, dims=(-2,)),
        "flip training clips at random, with motion and normals",
    ),
}
