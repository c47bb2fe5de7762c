"""The cost of scattered samples: a method's own counts traced against a full frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int
from torch import Tensor

from rlbench.render.jobs.live_pool import missing_samples
from rlbench.render.mitsuba.tracer import Tracer

__all__ = ["scatter_factor"]


def scatter_factor(tracer: Tracer, counts: Int[Tensor, "1 1 h w"]) -> float:
    """Time of a sample at these counts divided by that of a sample of a full frame at 1 spp.

    Both are traced in turn, so that other load on the machine slows both alike. Uniform counts have
    about 1; scattered ones have more, because neighbouring paths are less alike, and very few have
    much more, because a launch has a fixed cost. Raises ValueError without a sample.
    """
    drawn = counts.flatten().cpu().numpy()
    if not drawn.sum():
        raise ValueError("the counts are all zero; at least one sample is needed")
    pixels, samples = missing_samples(np.zeros_like(drawn), drawn)
    relative = tracer.relative_cost(lambda: tracer.trace(pixels, samples, "pilot"), 1)
    return relative * drawn.size / float(drawn.sum())
