"""Images of reports: which are shown, as a display shows them, and their squared errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.curves import UNDENOISED
from reports.analysis.rows import family_of
from rlbench.benchmark.results import MissingRowsError

if TYPE_CHECKING:
    from rlbench.benchmark.shown_clips import ShownClip, ShownImages

KNEE = 0.0031308  # IEC 61966-2-1: linear value below which the curve is a straight line
CAP_DB = 100.0  # PSNR of equal images
Floats = NDArray[np.floating[Any]]


def encode_srgb(radiance: Floats) -> Floats:
    """Clipped sRGB in [0, 1], float32, of linear radiance of any shape; NaN is black.

    The transfer curve of IEC 61966-2-1 (1999). It is repeated here because reports import neither
    torch nor metrics.

    >>> encode_srgb(np.array([-1.0, 0.0, 0.214041, 1.0, np.inf])).round(3).tolist()
    [0.0, 0.0, 0.5, 1.0, 1.0]
    """
    linear = np.nan_to_num(radiance.astype(np.float32), nan=0.0).clip(0, 1)
    curved = 1.055 * np.maximum(linear, KNEE) ** (1 / 2.4) - 0.055
    encoded: Floats = np.where(linear > KNEE, curved, 12.92 * linear).astype(np.float32)
    return encoded


def squared_error(image: Floats, reference: Floats) -> Floats:
    """Squared error [... h w] of linear images [... 3 h w] in sRGB, mean over channels, in [0, 1].

    A pixel that is not finite has the largest error, 1.
    """
    error = ((encode_srgb(image) - encode_srgb(reference)) ** 2).mean(axis=-3)
    is_finite = np.isfinite(image.astype(np.float32)).all(axis=-3)
    bounded: Floats = np.where(is_finite, error, 1.0)
    return bounded


def decibels(error: float) -> float:
    """PSNR at peak 1 of a mean squared error, at most 100 dB.

    >>> decibels(0.01), decibels(0.0)
    (20.0, 100.0)
    """
    return min(float(-10 * np.log10(max(error, 1e-30))), CAP_DB)


def select_images(
    clip: ShownClip, methods: Sequence[str], usual: Sequence[str], at_least: int, at_most: int
) -> list[ShownImages]:
    """The images of a clip: `methods` in their order, or without them `usual`, then the others.

    Raises MissingRowsError for a method without images, and where there are fewer than `at_least`.
    """
    images = {each.method: each for each in clip.images}
    available = ", ".join(images)
    if missing := [name for name in methods if name not in images]:
        raise MissingRowsError(
            f"no images of {', '.join(missing)} on {clip.name}; there are: {available}. Run the "
            "method with --keep-images at this budget"
        )
    order = list(methods) or list(dict.fromkeys(name for name in usual if name in images))
    order += [] if methods else [name for name in images if name not in order]
    if len(order) < at_least:
        raise MissingRowsError(
            f"{at_least} methods with images are compared; {clip.name} has {available}. Repeat "
            "`rlbench run --keep-images` with more methods"
        )
    return [images[name] for name in order[:at_most]]


def best_first(results: pd.DataFrame) -> list[str]:
    """Rows of the results by their mean PSNR, the best first, and raw samples last."""
    psnr = results[results["metric"] == "psnr"].groupby("method")["value"].mean().dropna()
    return sorted(map(str, psnr.index), key=lambda n: (family_of(n) in UNDENOISED, -psnr[n]))


def first_of_scenes(clips: Iterable[ShownClip], at_most: int) -> Iterator[ShownClip]:
    """The first clip of each scene, of the first `at_most` scenes."""
    scenes: set[str] = set()
    for clip in clips:
        if clip.scene not in scenes:
            scenes.add(clip.scene)
            yield clip
        if len(scenes) == at_most:
            return
