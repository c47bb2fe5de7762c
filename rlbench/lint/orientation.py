"""Do all buffers lie the same way up? Edges of each are laid over edges of the reference."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.lint.finding import Finding, fine, odd, wrong
from rlbench.lint.footage import Footage

CHECK = "orientation"
BETTER = 0.08  # of correlation, by which another way must be better
WEAK = 0.05  # correlation below which edges say nothing
WAYS = {
    "as it is": lambda e: e,
    "upside down": lambda e: e.flip(-2),
    "left to right": lambda e: e.flip(-1),
    "turned by 180 degrees": lambda e: e.flip(-1, -2),
}


def orientation(footage: Footage) -> Finding:
    """Do view and samples lie as the reference does, rows from the top, columns from the left?"""
    anchor = _edges(footage.reference.clamp_min(0).add(1e-3).log())
    images = dict(footage.view)
    if "depth" in images:
        images["depth"] = 1 / images["depth"].abs().clamp_min(1e-6)
    images |= {f"pool {k}": p.mean(1).clamp_min(0).add(1e-3).log() for k, p in footage.pools.items()}
    wrongly, told = [], []
    for name, image in images.items():
        own = _edges(image)
        fit = {way: correlation(turn(own), anchor) for way, turn in WAYS.items()}
        way = max(fit, key=lambda each: fit[each])
        if fit[way] - fit["as it is"] > BETTER:
            wrongly.append(f"{name} is {way} ({fit[way]:.2f} against {fit['as it is']:.2f})")
        told.append(f"{name} {fit['as it is']:.2f}")
    if wrongly:
        remedy = "write rows from the top and columns from the left; negate motion's axis too"
        return wrong(CHECK, f"against the reference, {'; '.join(wrongly)}", remedy)
    if len(images) and all(float(t.rsplit(" ", 1)[1]) < WEAK for t in told):
        return odd(CHECK, "edges are too few to tell", "look at the picture")
    return fine(CHECK, f"edges lie on those of the reference: {', '.join(told)}")


def correlation(one: Tensor, other: Tensor) -> float:
    """Pearson's, over all values; 0 where one is constant."""
    one, other = one - one.mean(), other - other.mean()
    size = one.norm() * other.norm()
    return float((one * other).sum() / size) if float(size) > 1e-12 else 0.0


def _edges(image: Float[Tensor, "t c h w"]) -> Float[Tensor, "t 1 h w"]:
    """Ranks of how much a slightly blurred image changes from pixel to pixel, in 0..1."""
    blurred = F.avg_pool2d(F.pad(image, (1, 1, 1, 1), mode="replicate"), 3, 1)
    across = (blurred[..., :-1, 1:] - blurred[..., :-1, :-1]).abs()
    down = (blurred[..., 1:, :-1] - blurred[..., :-1, :-1]).abs()
    change = (across + down).sum(1, keepdim=True)
    flat = change.flatten(1)
    ranks = flat.argsort(1).argsort(1).float() / max(flat.shape[1] - 1, 1)
    return ranks.view_as(change)
