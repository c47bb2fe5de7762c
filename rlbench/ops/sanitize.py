"""Sanitising: invalid values of radiance and G-buffer, replaced by one rule for each.

Valid values are returned unchanged, and on a CPU a tensor without invalid values without a copy
(rlbench.ops.asking). The core applies these rules before a method reads a frame (rlbench.sanitize).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.asking import may_ask
from rlbench.ops.transfer import HALF_MAX

__all__ = [
    "RULES",
    "repair_history",
    "sanitize_albedo",
    "sanitize_depth",
    "sanitize_motion",
    "sanitize_normal",
    "sanitize_radiance",
]

ALBEDO_TOLERANCE = 0.5  # outside [0, 1], up to which albedo is clamped rather than replaced
MAX_SQUARED_NORMAL = 1.02  # half floats and interpolation make unit normals a little longer
MAX_VALID_SQUARED_NORMAL = 4.0  # up to which a normal is scaled rather than replaced
OUTSIDE = 2.0  # image sizes that motion points away where no neighbour's is known
NEIGHBOURS = ((0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1))  # down, right


def sanitize_radiance(radiance: Float[Tensor, "*n 3 h w"]) -> Float[Tensor, "*n 3 h w"]:
    """Radiance clamped to [0, 65504]; black where any channel is not finite.

    65504 is the largest half float; the square of the result is finite in float32.
    """
    if _is_within(radiance, 0.0, HALF_MAX):
        return radiance
    finite = radiance.isfinite().all(-3, keepdim=True)
    return torch.where(finite, radiance, 0.0).clamp(0, HALF_MAX)


def sanitize_albedo(albedo: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Albedo clamped to [0, 1].

    A pixel that is not finite, or more than 0.5 outside that range, gets a neighbour's albedo.
    """
    if _is_within(albedo, 0.0, 1.0):
        return albedo
    valid = ((albedo - 0.5).abs() <= 0.5 + ALBEDO_TOLERANCE).all(1, keepdim=True)
    return _fill_from_neighbours(albedo, valid, 0.0).clamp(0, 1)


def sanitize_normal(normal: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Normals scaled to unit length where they are longer.

    A pixel that is not finite, or longer than 2, gets a neighbour's normal. Shorter normals stay:
    an average over a pixel is shorter than 1, and background has none.
    """
    squared = normal.square().sum(1, keepdim=True)  # may overflow to inf
    if may_ask(squared) and bool(squared.amax() <= MAX_SQUARED_NORMAL):  # False for NaN
        return normal
    normal = _fill_from_neighbours(normal, squared <= MAX_VALID_SQUARED_NORMAL, 0.0)
    is_long = normal.square().sum(1, keepdim=True) > MAX_SQUARED_NORMAL
    return torch.where(is_long, F.normalize(normal, dim=1), normal)


def sanitize_depth(depth: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """Depth; a pixel that is NaN or no normal positive float gets a neighbour's depth.

    +inf is background. Denormal numbers are not valid: no surface is that close to a camera.
    """
    valid = depth >= torch.finfo(depth.dtype).tiny  # False for NaN
    if may_ask(valid) and bool(valid.all()):
        return depth
    return _fill_from_neighbours(depth, valid, torch.inf)


def sanitize_motion(motion: Float[Tensor, "n 2 h w"]) -> Float[Tensor, "n 2 h w"]:
    """Motion; a pixel that is not finite gets a neighbour's motion."""
    limit = torch.finfo(motion.dtype).max
    if _is_within(motion, -limit, limit):
        return motion
    valid = motion.isfinite().all(1, keepdim=True)
    return _fill_from_neighbours(motion, valid, OUTSIDE * max(motion.shape[-2:]))


def _fill_from_neighbours(
    values: Float[Tensor, "n c h w"], valid: Bool[Tensor, "n 1 h w"], fallback: float
) -> Float[Tensor, "n c h w"]:
    """The values, where invalid those of the first valid one of eight neighbours, or `fallback`."""
    c, h, w = values.shape[1:]
    inside, missing = F.pad(valid, (1,) * 4), ~valid
    step = torch.zeros_like(valid, dtype=torch.int64)  # pixels from each to the one it takes
    for down, right in NEIGHBOURS:
        usable = missing & inside[..., 1 + down : 1 + down + h, 1 + right : 1 + right + w]
        step, missing = step.masked_fill(usable, down * w + right), missing & ~usable
    source = (torch.arange(h * w, device=values.device) + step.flatten(2)).expand(-1, c, -1)
    return values.flatten(2).gather(2, source).view_as(values).where(~missing, fallback)


def repair_history(
    history: Float[Tensor, "n c h w"], least: float, most: float | Float[Tensor, "n 1 _ _"]
) -> Float[Tensor, "n c h w"]:
    """History in which a pixel that is not finite, or outside [least, most], equals a neighbour.

    Before reprojection, so that one bad value neither spreads over the taps nor stays for good.

    >>> repair_history(torch.tensor([[[[0.5, torch.nan, 0.25]]]]), least=0.0, most=1.0)
    tensor([[[[0.5000, 0.5000, 0.2500]]]])
    """
    asks = may_ask(history)
    if asks and _is_within(
        history, least, most if isinstance(most, float) else float(most.detach().amin())
    ):
        return history
    valid = ((history >= least) & (history <= most)).all(1, keepdim=True)  # False for NaN
    if asks and valid.all():
        return history
    return _fill_from_neighbours(history, valid, 0.0)


RULES: Mapping[str, Callable[[Tensor], Tensor]] = {  # by the first word of a buffer's name
    "albedo": sanitize_albedo,
    "normal": sanitize_normal,
    "depth": sanitize_depth,
    "motion": sanitize_motion,
}


def _is_within(values: Tensor, low: float, high: float) -> bool:
    """True if all values lie in [low, high]; False for NaN, and where it is not known. One pass."""
    if not may_ask(values):
        return False
    if not values.numel():
        return True
    least, most = values.aminmax()
    return bool((least >= low) & (most <= high))
