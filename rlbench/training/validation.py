"""How good averaged weights are on clips that are not trained on."""

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

BUDGETS = (1.0, 4.0)  # samples per pixel, unless others are trained for


class ValidationResult(NamedTuple):
    """What a validation found."""

    psnr: float  # dB, mean over clips, budgets and frames
    picture: Float[Tensor, "3 h w"] | None  # last frame of the first clip, reference at its right


def budgets(method: Method, trained: Sequence[float], asked: Sequence[float]) -> list[float]:
    """The budgets to validate at.

    1 and 4 spp where the method takes both and nothing else was asked for; else the least and the
    largest of those that it is trained for.
    """
    if not asked and not any(method.traits.unsupported_reason(spp) for spp in BUDGETS):
        return list(BUDGETS)
    return sorted({min(asked or trained), max(asked or trained)})


def validate(
    method: Method,
    networks: nn.Module,
    average: nn.Module,
    folders: Sequence[Path],
    spp: Sequence[float],
    device: str,
) -> ValidationResult:
    """Mean PSNR of the averaged weights at each budget, all frames.

    `networks` have their own weights again afterwards, and are set to evaluation.
    """
    psnr = registry.load("metrics", "psnr").score
    trained = copy.deepcopy(networks.state_dict())
    networks.load_state_dict(average.state_dict())
    networks.eval()
    scores: list[float] = []
    picture = None
    for folder in folders:
        for budget in spp:
            traits = method.traits
            clip = open_clip(folder, traits.inputs, pool=traits.pool, device=device)
            for shown in run_clip(method, clip, budget):
                reference = shown.frame.reference
                scores += psnr(shown.image, reference.half_a, reference.half_b).tolist()
            if folder == folders[0] and budget == spp[0]:
                picture = torch.cat((shown.image[0], reference.mean[0]), dim=-1)
    networks.load_state_dict(trained)
    return ValidationResult(sum(scores) / max(len(scores), 1), picture)
