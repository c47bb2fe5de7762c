"""From a network's map to a density: its exponential, bounded so that no pixel is at zero."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

LOWEST = -30.0  # log density below which a pixel is at its floor in any case


def exponential(wish: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """Density exp(x - max x) of a map x, in [exp(-30), 1], 1 where it is largest.

    Kuznetsov et al. 2018 take the exponential; it does not change when a constant is added to x.
    """
    return (wish - wish.amax((2, 3), keepdim=True)).clamp_min(LOWEST).exp()
