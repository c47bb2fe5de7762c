"""relL2: squared error over the squared brightness of the reference's pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from metrics.metric import Comparison, Metric

if TYPE_CHECKING:
    from jaxtyping import Float
    from torch import Tensor

__all__ = ["REL_L2", "rel_l2"]

EPS = 1e-2  # avoids division by zero where the reference is black


def rel_l2(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Relative squared error of linear radiance, without unit; lower is better, 0 is best.

    mean((x - r)^2 / (m^2 + 0.01)) over pixels and channels, with m the mean of the reference's
    three channels, as in the authors' code of Choi et al. 2024 (Online Neural Denoising with
    Cross-Regression). `relmse` divides each channel by its own reference, so the dark channel of a
    saturated colour weighs more there.

    >>> import torch
    >>> red = torch.tensor([1.0, 0.0, 0.5]).view(1, 3, 1, 1)
    >>> rel_l2(red + 0.1, red)  # 0.01 / (0.5^2 + 0.01)
    tensor([0.0385])
    """
    error = (image - reference).square()
    brightness = reference.mean(1, keepdim=True)
    relative: Tensor = error / (brightness.square() + EPS)
    return relative.flatten(1).double().mean(1).float()


def _score(frame: Comparison) -> Any:
    return rel_l2(*frame.linear)


REL_L2 = Metric(
    "rel_l2",
    "",
    "lower",
    "linear radiance, reference's mean over channels^2 + 0.01",
    _score,
    scored_by_run=False,  # it is close to relmse
    pixelwise=True,
    source="Choi et al. 2024",
)
