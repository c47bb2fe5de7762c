"""Train NPPD: relative error of images and of their change, on overlapping pairs of frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.accumulate.memory import LightHistory
from baselines.nppd import FAMILY
from baselines.nppd.method import VARIANTS, Nppd
from baselines.nppd.network import Networks
from rlbench.frames import Clip, GBuffer, Samples, Size
from rlbench.ops.losses import smape
from rlbench.ops.reprojection import reproject_or_fill
from rlbench.run import unroll
from rlbench.training import BUDGETS_FROM_1_SPP, TrainingTask
from rlbench.wrappers import MethodWrapper

BUDGETS = (0.25, 0.5, *BUDGETS_FROM_1_SPP)  # spp, one drawn for each sequence
FIRST_WEIGHT = 8.0  # of the error of a first frame
SPATIAL_WEIGHT = 2.0  # of the error of both frames of a pair
TEMPORAL_WEIGHT = 0.2  # of the error of the change between them
EPS = 1e-3  # of SMAPE
MEAN_OFFSET = 1e-8  # added to the mean of the reference before division


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """NPPD with seeded weights and the loss of its authors' release, without features.

    A first frame counts 8 SMAPE. Every later frame is computed together with the one before it, so
    gradients cross one frame; the pair counts 2 SMAPE of both images, plus 0.2 SMAPE of the change
    from the reprojected first image to the second. Radiance is divided by the mean of the reference
    (of both frames). The release adds 0.025 to 0.1 times the L1 distance of features of a
    segmentation network, which is left out. The crops and the schedule are those that all methods
    here share; the release uses Adam at 1e-4, decayed by 0.94 an epoch.
    """
    config = VARIANTS[variant]
    networks = Networks(config.widths)
    networks.init_weights(seed)
    networks.to(device)
    method = Nppd(networks, config, FAMILY.variants[variant].traits)
    return TrainingTask(method, networks, partial(losses, method), BUDGETS)


def losses(method: Nppd, clip: Clip, spp: float) -> Iterator[Float[Tensor, ""]]:
    """One loss for each frame, see `training_task`; frames after the first are computed twice."""
    pairs = FramePairs(method)
    previous: Tensor | None = None  # reference of the previous frame
    for result in unroll(pairs, clip, spp):
        reference, motion = result.frame.reference.mean, pairs.motions.pop()
        if (first := pairs.first_images.pop()) is None or previous is None:
            yield _first_frame_loss(result.image, reference)
        else:
            yield _pair_loss((first, result.image), (previous, reference), motion)
        previous = reference


class PairState(NamedTuple):
    """The previous frame's inputs and the state before it."""

    gbuffer: GBuffer | None  # None before the first frame
    samples: Samples | None
    state: LightHistory  # detached


@dataclass(frozen=True)
class FramePairs(MethodWrapper[Nppd]):
    """The method, while each frame follows a second run of the previous one, with its gradients.

    The state before the pair is detached, as in the release. `first_images` and `motions` hold what
    the loss needs of frames that were not yet read.
    """

    first_images: list[Tensor | None] = field(default_factory=list)  # of the pair, None without one
    motions: list[Tensor | None] = field(default_factory=list)  # from the second image to the first

    def start(self, size: Size) -> PairState:
        """The state before the first frame."""
        return PairState(None, None, self.method.start(size))

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: PairState
    ) -> tuple[Float[Tensor, "n 3 h w"], PairState]:
        """The second image of the pair."""
        first, before = None, state.state
        if state.gbuffer is not None and state.samples is not None:
            first, before = self.method.denoise(state.gbuffer, state.samples, before)
        image, _ = self.method.denoise(gbuffer, samples, before)
        self.first_images.append(first)
        self.motions.append(gbuffer.motion)
        return image, PairState(gbuffer, samples, before.detach())


def _first_frame_loss(image: Tensor, reference: Tensor) -> Float[Tensor, ""]:
    scale = reference.mean((1, 2, 3), keepdim=True) + MEAN_OFFSET
    return FIRST_WEIGHT * smape(image / scale, reference / scale, EPS)


def _pair_loss(
    images: tuple[Tensor, Tensor], references: tuple[Tensor, Tensor], motion: Tensor | None
) -> Float[Tensor, ""]:
    """Error of both images, and of the change to the second; zero history outside the image."""
    scale = torch.stack(references).mean((0, 2, 3, 4)).view(-1, 1, 1, 1) + MEAN_OFFSET
    images = (images[0] / scale, images[1] / scale)
    references = (references[0] / scale, references[1] / scale)
    spatial = smape(torch.cat(images), torch.cat(references), EPS)
    change, reference_change = (
        second - reproject_or_fill(first, motion, 0.0) for first, second in (images, references)
    )
    return SPATIAL_WEIGHT * spatial + TEMPORAL_WEIGHT * smape(change, reference_change, EPS)
