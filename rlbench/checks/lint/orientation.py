"""Do all buffers lie the same way up? Edges of each are laid over those of the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.checks.finding import Finding, fine, odd, wrong
from rlbench.checks.lint.clip_arrays import ClipArrays

CHECK = "orientation"
AROUND = 9  # pixels: ranks of edges are compared with their surroundings
BETTER = 0.05  # of correlation, by which another way must be better; chance is below 0.02 on ours
WAYS: dict[str, Callable[[Tensor], Tensor]] = {
    "as it is": lambda image: image,
    "upside down": lambda image: image.flip(-2),
    "left to right": lambda image: image.flip(-1),
    "turned by 180 degrees": lambda image: image.flip(-1, -2),
}


def ways(footage: ClipArrays) -> dict[str, dict[str, float]]:
    """For each buffer, the correlation of its edges in each way to lie, by the name of the way.

    Edges of albedo, normal, depth and samples are laid over those of the reference, edges of motion
    over those of depth and normal.
    """
    edges = {name: _edges(_plain(name, image)) for name, image in footage.gbuffer.items()}
    lines, light = _edges(_log(footage.reference)), _detail(_log(footage.reference))
    compared = {name: (edge, lines) for name, edge in edges.items() if name != "motion"}
    if {"motion", "normal", "depth"} <= set(edges):
        compared["motion"] = (edges["motion"], edges["normal"] + edges["depth"])
    compared |= {_pool(k): (_detail(_log(p.mean(1))), light) for k, p in footage.pools.items()}
    return {
        name: {way: _correlation(turn(own), anchor) for way, turn in WAYS.items()}
        for name, (own, anchor) in compared.items()
    }


def misoriented(found: dict[str, dict[str, float]]) -> dict[str, str]:
    """The way in which a buffer lies, by name, of those that do not lie as the others do."""
    best = {name: max(fit, key=lambda way: fit[way]) for name, fit in found.items()}
    return {k: w for k, w in best.items() if found[k][w] - found[k]["as it is"] > BETTER}


def reoriented(footage: ClipArrays, found: dict[str, dict[str, float]]) -> ClipArrays:
    """The footage with its pools as the reference lies, for checks that compare the two."""
    lying = misoriented(found)
    pools = {k: WAYS[lying.get(_pool(k), "as it is")](p) for k, p in footage.pools.items()}
    return replace(footage, pools=pools)


def orientation(found: dict[str, dict[str, float]]) -> Finding:
    """Do view and samples lie as the reference does, rows from the top, columns from the left?

    `found` is that of `ways`. A clip of which all is upside down has no such fault.
    """
    told = ", ".join(f"{name} {fit['as it is']:.2f}" for name, fit in found.items())
    if lying := misoriented(found):
        parts = (
            f"{name} is {way} ({found[name][way]:.2f} against {found[name]['as it is']:.2f})"
            for name, way in lying.items()
        )
        remedy = "write rows from the top and columns from the left; motion's axis turns with them"
        return wrong(CHECK, f"by its edges, {'; '.join(parts)}", remedy)
    if all(fit["as it is"] < BETTER for fit in found.values()):
        return odd(CHECK, f"edges are too few to tell: {told}", "look at the picture")
    return fine(CHECK, f"edges lie on those of the reference: {told}")


def _pool(kind: str) -> str:
    return f"pool {kind}"


def _plain(name: str, image: Tensor) -> Tensor:
    return 1 / image.abs().clamp_min(1e-6) if name.startswith("depth") else image


def _log(radiance: Tensor) -> Tensor:
    return (radiance.clamp_min(0) + 1e-2 * radiance.mean().clamp_min(1e-6)).log()


def _edges(image: Float[Tensor, "t c h w"]) -> Float[Tensor, "t 1 h w"]:
    """How much a pixel differs from the one before it, as a detail of ranks."""
    change = torch.zeros_like(image[:, :1])
    change[..., 1:] += (image[..., 1:] - image[..., :-1]).abs().sum(1, keepdim=True)
    change[..., 1:, :] += (image[..., 1:, :] - image[..., :-1, :]).abs().sum(1, keepdim=True)
    return _detail(change)


def _detail(image: Float[Tensor, "t c h w"]) -> Float[Tensor, "t 1 h w"]:
    """Ranks in 0..1 of the mean channel, less the mean of their surroundings.

    Gradients over the whole image, which are the same in two mirrored ones, fall out.
    """
    flat = image.mean(1).flatten(1)
    ranks = (flat.argsort(1).argsort(1).float() / flat.shape[1]).view_as(image[:, :1])
    margin = [AROUND // 2] * 4
    return ranks - F.avg_pool2d(F.pad(ranks, margin, mode="replicate"), AROUND, 1)


def _correlation(one: Tensor, other: Tensor) -> float:
    one, other = one - one.mean(), other - other.mean()
    return float((one * other).sum() / (one.norm() * other.norm()).clamp_min(1e-9))
