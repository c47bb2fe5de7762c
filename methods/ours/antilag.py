"""How far light of earlier frames still holds: not where new samples say that it has changed."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from methods.ours.accumulation import AccumulatedRadiance
from rlbench.ops.color import luminance
from rlbench.ops.padding import crop
from rlbench.ops.transfer import log_inverse

CELL = 4  # pixels a side, of which sums are taken before windows are
WINDOWS = (3, 5, 13)  # cells a side: what changed may be small, or too dim to show in few pixels
ERRORS = 2.0  # standard errors of a change that are taken for noise
STEEP = 3.0  # a sure change of one part in so many forgets all
FEW = 3.0  # pixels that a window needs
FAINT = 0.1  # radiance beside which what is darker counts no more


@torch.no_grad()
def history_confidence(
    old: AccumulatedRadiance, new: AccumulatedRadiance, image: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, "n 1 h w"]:
    """The share of the old light that is still believed, in [0, 1]; 1 where nothing says otherwise.

    Schied, Peters and Dachsbacher 2018: memory is given up by |change| over the larger of both.
    They compare samples of the same random numbers; ours are other ones, so the change is a
    window's mean, of pixels that have both, less what may be chance. Its error is that which is
    seen or, if larger, that which the old light's spread foretells: where few samples are bright, a
    window without any looks as if it had gone dark.

    Pixels count by what they are of the last `image` (in log transfer), else a lamp that stays
    hides what goes dark around it; not of the old light: what is dark there by chance brightens.
    """
    h, w = new.accumulated_spp.shape[-2:]
    doubt = F.interpolate(
        relative_change(old, new, image), scale_factor=float(CELL), mode="bilinear"
    )
    return (1 - STEEP * crop(doubt, h, w)).clamp(0, 1)


def relative_change(
    old: AccumulatedRadiance, new: AccumulatedRadiance, image: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, "n 1 h2 w2"]:
    """What part of the light has surely changed, of cells: that of the window where it is most."""
    h, w = new.accumulated_spp.shape[-2:]
    both = ((new.accumulated_spp > 0) & (old.accumulated_spp > 0)).to(new.mean.dtype)
    scale = 1 / (luminance(log_inverse(image)).clamp_min(0) + FAINT)
    then, now = luminance(old.mean) * scale, luminance(new.mean) * scale
    change, spread = now - then, old.variance * scale.square()
    foretold = spread * (
        1 / new.accumulated_spp.clamp_min(1) + 1 / old.accumulated_spp.clamp_min(1)
    )
    each = both * torch.cat((both, change, change.square(), foretold, then, now), 1)
    cells = F.avg_pool2d(F.pad(each, (0, -w % CELL, 0, -h % CELL)), CELL)
    return torch.stack([_doubt(cells, side) for side in WINDOWS]).amax(0)


def _doubt(cells: Float[Tensor, "n 6 h w"], side: int) -> Float[Tensor, "n 1 h w"]:
    """The change of each window over the larger of both, less what may be chance."""
    share, *sums = F.avg_pool2d(cells, side, 1, side // 2).chunk(6, 1)
    change, square, foretold, then, now = (total / share.clamp_min(1e-6) for total in sums)
    pixels = share * (side * CELL) ** 2
    variance = torch.maximum((square - change.square()).clamp_min(0), foretold)
    error = (variance / pixels.clamp_min(1)).sqrt()
    certain = (change.abs() - ERRORS * error).clamp_min(0)
    return (certain / torch.maximum(then, now).clamp_min(1e-4)).where(pixels > FEW, 0.0)
