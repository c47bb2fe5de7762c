"""Validation: mean PSNR of the averaged weights on clips that are not trained on."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.method import Method
from rlbench.run import run_clip

__all__ = ["SetScore", "ValidationResult", "validate", "validation_budgets"]

DEFAULT_BUDGETS = (1.0, 4.0)  # samples per pixel


class SetScore(NamedTuple):
    """The score of one validation set, in dB."""

    psnr: float  # mean over clips, budgets and frames
    first_frames: float  # mean over clips and budgets of the first frame, which has no history


class ValidationResult(NamedTuple):
    """The scores of one validation, and an image to look at."""

    sets: dict[str, SetScore]  # by name of the validation set
    preview: Float[Tensor, "3 h w"] | None  # last frame of the first clip, reference on its right

    @property
    def psnr(self) -> float:
        """Mean PSNR over the validation sets, dB; 0 without any."""
        return fmean(score.psnr for score in self.sets.values()) if self.sets else 0.0


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
    sets: Mapping[str, Sequence[Path]],
    spp: Sequence[float],
    device: str,
) -> ValidationResult:
    """Mean PSNR of the averaged weights on each set of clips, at each budget in `spp`.

    A clip with fewer samples than a budget is validated with all that it has. `networks` are the
    ones that `method` uses. They get their own weights back, and are left in evaluation mode.
    """
    psnr = registry.load_plugin("metrics", "psnr")
    trained = copy.deepcopy(networks.state_dict())
    networks.load_state_dict(ema_networks.state_dict())
    networks.eval()
    scores: dict[str, SetScore] = {}
    preview = None
    for name, clips in sets.items():
        frames, first_frames = [], []
        for folder in clips:
            traits = method.traits
            clip = open_clip(folder, traits.inputs, pool=traits.pool, device=device)
            for budget in sorted({min(budget, float(clip.max_samples)) for budget in spp}):
                psnrs = []
                for result in run_clip(method, clip, budget):
                    reference = result.frame.reference
                    compared = psnr.compare(result.image, reference.half_a, reference.half_b)
                    psnrs += psnr.score(compared).tolist()
                frames += psnrs
                first_frames += psnrs[:1]
                if preview is None:
                    preview = torch.cat((result.image[0], reference.mean[0]), dim=-1)
        scores[name] = SetScore(fmean(frames or [0.0]), fmean(first_frames or [0.0]))
    networks.load_state_dict(trained)
    return ValidationResult(scores, preview)
