"""From a network's map to a density: its exponential, kept in a range where all of it can learn."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

STEEP = 1.5  # root mean square of a map's log density; steeper maps are drawn in towards it
FAR = 3.0  # log density above and below its mean, which none reaches


def bounded_exp_density(wish: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """Density exp(y - max y) of a map x, in [exp(-2 FAR), 1], 1 where it is largest.

    Kuznetsov et al. 2018 take the exponential of the network's output, and so does what follows
    them. Ours: y is x less its mean, divided by (1 + (rms / STEEP)^2)^(1/2) and bounded by
    FAR tanh(y / FAR). Without that a map whose scale grows in training ends with one pixel above
    all others, beyond what exponentials in float32 tell apart, and no gradient ever reaches it
    again. Faint maps are as they were, and a constant that is added to x changes nothing.
    """
    apart = wish - wish.mean((2, 3), keepdim=True)
    size = apart.square().mean((2, 3), keepdim=True)
    drawn = FAR * (apart / (1 + size / STEEP**2).sqrt() / FAR).tanh()
    return (drawn - drawn.amax((2, 3), keepdim=True)).exp()
