"""ColorVideoVDP of whole clips, by its authors' package `cvvdp`."""

from __future__ import annotations

import importlib.metadata
from dataclasses import replace
from functools import cache
from typing import Any

from metrics.metric import Comparison, Metric

__all__ = ["CVVDP", "DISPLAY", "FRAMES_PER_SECOND", "cvvdp"]

DISPLAY = "standard_4k"  # of the package: 30 inches, 3840x2160, 200 cd/m2, seen from 0.7472 m
FRAMES_PER_SECOND = 24.0  # the default of clips; other rates of a clip are not known here


def cvvdp(comparisons: list[Comparison]) -> float:
    """Quality of a clip in just-objectionable differences (JOD), at most 10; higher is better.

    Mantiuk et al. 2024, ColorVideoVDP: a visual difference predictor for image, video and display
    distortions. 10 is no visible difference; 1 less means that three of four people prefer the
    reference. Frames are clipped sRGB on the display DISPLAY, at FRAMES_PER_SECOND. A clip of one
    frame is an image. A pixel that is not finite is black or white, whichever is further from the
    reference.

    ```python
    quality = cvvdp([CVVDP.compare(image, reference, reference) for image in images])
    ```
    """
    import torch

    test = torch.stack([each.display_image[0] for each in comparisons], 1)[None]
    reference = torch.stack([each.display_reference[0] for each in comparisons], 1)[None]
    rate = FRAMES_PER_SECOND if len(comparisons) > 1 else 0
    predictor = _predictor(str(test.device))
    quality, _ = predictor.predict(test, reference, dim_order="BCFHW", frames_per_second=rate)
    return float(quality)


@cache
def _predictor(device: str) -> Any:
    import pycvvdp
    import torch

    return pycvvdp.cvvdp(display_name=DISPLAY, device=torch.device(device), quiet=True)


def _with_version(height: int, width: int) -> Metric:
    """The metric whose convention names the installed version of the package."""
    version = importlib.metadata.version("cvvdp")
    return replace(CVVDP, convention=f"cvvdp {version}; {CVVDP.convention}", fit=None)


CVVDP = Metric(
    name="cvvdp",
    unit="JOD",
    direction="higher",
    convention="ColorVideoVDP of clipped sRGB in float, all frames of a clip; display "
    f"{DISPLAY}, {FRAMES_PER_SECOND:g} frames per second",
    score=cvvdp,
    fit=_with_version,
    source="Mantiuk et al. 2024",
    requires=("cvvdp",),
    scored_by_run=False,
    whole_clip=True,
)
