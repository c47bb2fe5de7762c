"""Sampling density from a network's output: an exponential within a trainable range."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

__all__ = ["bounded_exp_density"]

RMS_LIMIT = 1.5  # root mean square of the log density that steeper maps approach
MAX_LOG_DENSITY = 3.0  # bound of the log density above and below its mean; never reached


def bounded_exp_density(logits: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """Density exp(z - max z) for logits x, in [exp(-6), 1], with maximum 1 in each image.

    y = (x - mean x) / sqrt(1 + (rms / 1.5)^2), where rms is the root mean square of x - mean x, and
    z = 3 tanh(y / 3). Adding a constant to x changes nothing, and maps of small contrast become
    exp(x) up to scale.

    Kuznetsov et al. 2018 and later work use exp(x) alone. Differs from them: without the bounds, a
    map whose scale grows in training ends with one pixel above all others, further than float32
    exponentials can resolve, and gradients never reach it again.

    >>> import torch
    >>> bounded_exp_density(torch.zeros(1, 1, 1, 3)).flatten().tolist()
    [1.0, 1.0, 1.0]
    """
    centred = logits - logits.mean((2, 3), keepdim=True)
    mean_square = centred.square().mean((2, 3), keepdim=True)
    scaled = centred / (1 + mean_square / RMS_LIMIT**2).sqrt()
    log_density = MAX_LOG_DENSITY * (scaled / MAX_LOG_DENSITY).tanh()
    return (log_density - log_density.amax((2, 3), keepdim=True)).exp()
