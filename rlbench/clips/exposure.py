"""The exposure of a clip, from the luminance of areas of its frames."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray as Array
from torch.nn import functional as F

from rlbench.ops.color import REC709_LUMINANCE, luminance

AREAS = 8  # along each side; luminance is averaged over them because samples are noisy
LIT = 0.01  # of the light of the brightest frame, from which on a frame is not in the dark
GREY, WHITE = 0.18, 1.0  # display values of the log-average, and of the 95th percentile at most


def exposure_from_areas(areas: Float[Array, "..."]) -> float:
    """The exposure for these luminances, at least one of them above 0; to two digits.

    The log-average luminance becomes 0.18 (Reinhard et al. 2002, Photographic Tone Reproduction),
    or less if more than 5 % of the areas would exceed white.

    >>> exposure_from_areas(np.full(64, 0.36))
    0.5
    """
    average = np.exp(np.log(areas[areas > 0]).mean())
    return float(f"{min(GREY / average, WHITE / np.percentile(areas, 95)):.2g}")


def exposure_of_frames(areas: Float[Array, "frames areas"]) -> float:
    """The exposure for frames of one shot, of those that have light; 1 if none has.

    A shot that begins in the dark, or ends there, so gets the exposure of what is seen.

    >>> exposure_of_frames(np.stack([np.full(64, 1e-6), np.full(64, 0.36)]))
    0.5
    """
    light = areas.mean(1)
    return exposure_from_areas(areas[light >= LIT * light.max()]) if light.max() > 0 else 1.0


def area_luminance(image: Float[Array, "h w 3"]) -> Float[Array, " areas"]:
    """Mean luminance of 8 x 8 areas of an image with linear radiance, float64.

    Where a side is not a multiple of 8, neighbouring areas overlap by a pixel.
    """
    rgb = torch.from_numpy(np.asarray(image, np.float64)).movedim(-1, 0)
    areas = F.adaptive_avg_pool2d(luminance(rgb, REC709_LUMINANCE), AREAS)
    return np.asarray(areas.numpy().ravel())
