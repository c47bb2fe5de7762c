"""A small moving scene with all the cases that a temporal filter must handle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from rlbench.frames import GBuffer
from tests.baselines.noise import array

SIDE = 32
FRAMES = 3


@dataclass(frozen=True)
class Moving:
    """One frame of the scene."""

    gbuffer: GBuffer
    radiance: Tensor  # [1 3 h w], one sample per pixel

    @property
    def noisy(self) -> np.ndarray:
        """Radiance, [h w 3] in double precision."""
        return array(self.radiance)

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Albedo, normal, depth without a channel axis, and motion, in double precision."""
        return (
            array(self.gbuffer.albedo),
            array(self.gbuffer.normal),
            array(self.gbuffer.depth)[..., 0],
            array(self.gbuffer.motion),
        )


def frame(index: int) -> Moving:
    """A tilted moving floor, a faster board in front of it, an emitter, and background.

    No depth or normal test of the history is close to its threshold, and motion is a multiple of
    1/8 pixel, so that single and double precision select the same pixels.
    """
    source = np.random.default_rng(index)
    y, x = np.mgrid[:SIDE, :SIDE].astype(float)
    board = (abs(x - 8 - 2.375 * index) < 6) & (abs(y - 15 - 1.25 * index) < 7)
    background = y < 4
    emitter = (abs(x - 26) < 2) & (abs(y - 24) < 2)
    depth = np.where(board, 3 + 0.01 * x, 8 - 0.1 * y + 0.02 * x)
    normal = np.where(board[..., None], [0.0, 0.0, 1.0], [0.0, 0.6, 0.8])
    bump = np.stack([0.05 * np.sin(x / 2), 0.05 * np.cos(y / 3), 0 * x], -1)
    normal = (normal + bump) / np.linalg.norm(normal + bump, axis=-1, keepdims=True)
    albedo = 0.1 + 0.8 * np.stack([x / SIDE, y / SIDE, (x.astype(int) + y.astype(int)) % 2], -1)
    motion = np.where(board[..., None], [-2.375, -1.25], [0.5, -0.625])
    depth[background] = np.inf
    normal[background] = albedo[background] = albedo[emitter] = 0
    light = np.where(x < 18, 1.0, 0.25)[..., None] * source.exponential(size=(SIDE, SIDE, 3))
    light[source.random((SIDE, SIDE)) < 0.01] *= 50
    radiance = np.where((background | emitter)[..., None], 2.0, light * albedo)
    buffers = {"albedo": albedo, "normal": normal, "depth": depth[..., None], "motion": motion}
    return Moving(GBuffer({k: _tensor(v) for k, v in buffers.items()}), _tensor(radiance))


def _tensor(image: np.ndarray) -> Tensor:
    return torch.from_numpy(image).float().permute(2, 0, 1)[None]
