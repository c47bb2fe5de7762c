"""Validation: mean PSNR of the averaged weights on clips that are not trained on."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.method import Method
from rlbench.run import run_clip

__all__ = ["ValidationResult", "validation_budgets", "validate"]

DEFAULT_BUDGETS = (1.0, 4.0)  # samples per pixel


class ValidationResult(NamedTuple):
    """The score of one validation, and an image to look at."""

    psnr: float  # dB, mean over clips, budgets and frames
    preview: Float[Tensor, "3 h w"] | None  # last frame of the first clip, reference on its right


def validation_budgets(
    method: Method, training_budgets: Sequence[float], requested: Sequence[float]
) -> list[float]:
    """The budgets to validate at, in samples per pixel.

    1 and 4 spp if the method supports both and no training budgets were `requested`. Otherwise the
    smallest and the largest budget that the method is trained at.
    """
    unsupported = any(method.traits.unsupported_reason(spp) for spp in DEFAULT_BUDGETS)
    if not requested and not unsupported:
        return list(DEFAULT_BUDGETS)
    return sorted({min(requested or training_budgets), max(requested or training_budgets)})


def validate(
    method: Method,
    networks: nn.Module,
    ema_networks: nn.Module,
    clips: Sequence[Path],
    spp: Sequence[float],
    device: str,
) -> ValidationResult:
    """Mean PSNR of the averaged weights on all frames of the clips, at each budget in `spp`.

    `networks` are the ones that `method` uses. They get their own weights back, and are left in
    evaluation mode.
    """
    psnr = registry.load_plugin("metrics", "psnr")
    trained = copy.deepcopy(networks.state_dict())
    networks.load_state_dict(ema_networks.state_dict())
    networks.eval()
    scores: list[float] = []
    preview = None
    for folder in clips:
        for budget in spp:
            traits = method.traits
            clip = open_clip(folder, traits.inputs, pool=traits.pool, device=device)
            for result in run_clip(method, clip, budget):
                reference = result.frame.reference
                compared = psnr.compare(result.image, reference.half_a, reference.half_b)
                scores += psnr.score(compared).tolist()
            if folder == clips[0] and budget == spp[0]:
                preview = torch.cat((result.image[0], reference.mean[0]), dim=-1)
    networks.load_state_dict(trained)
    return ValidationResult(sum(scores) / max(len(scores), 1), preview)
