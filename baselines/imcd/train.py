"""Training IMCD: relative error of the image and of its change, on frames two by two."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.imcd import FAMILY
from baselines.imcd.method import Imcd, State
from baselines.imcd.network import Kernels, Networks
from rlbench.family import Traits
from rlbench.frames import Clip, GBuffer, Samples, Size
from rlbench.ops.losses import smape
from rlbench.run import unroll
from rlbench.training import BUDGETS_FROM_1_SPP, TrainingTask

CHANGE = 0.25  # weight of the error of the change since the last frame
STRAIN = 1e-5  # weight of squared sharpness


def trainer(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """IMCD with seeded weights and its loss, eq. 11 to 13 of Isik et al. 2021.

    SMAPE of the image plus 0.25 SMAPE of its change since the last frame, both against the
    reference's, plus 1e-5 of the mean of a^2 + b^2 over pixels and passes.

    Ours, for it could not be verified: the space, linear radiance with albedo, not clamped. SMAPE
    is relative by itself, so that it needs no transfer to weigh dark and bright alike, and in
    radiance it is blind to where albedo makes up for light. Ours too: its epsilon of 0.01, the
    budgets, and that all frames of each `bptt` count. The schedule is the one that
    all methods here share.
    """
    networks = Networks()
    networks.draw(seed)
    networks.to(device)
    method = Imcd(networks, traits=FAMILY.variants[variant].traits)
    return TrainingTask(method, networks, partial(losses, method), BUDGETS_FROM_1_SPP)


def losses(method: Imcd, clip: Clip, spp: float) -> Iterator[Float[Tensor, ""]]:
    """One loss for each `bptt` frames: the mean of theirs; see `trainer`."""
    watched = SharpnessRecorder(method)
    terms: list[Tensor] = []  # of the frames since the last yield
    before: tuple[Tensor, Tensor] | None = None  # image and reference of the last frame
    for shown in unroll(watched, clip, spp):
        image, truth = shown.image, shown.frame.reference.mean
        terms.append(smape(image, truth) + STRAIN * watched.strain.pop())
        if before is not None:
            terms[-1] = terms[-1] + CHANGE * smape(image - before[0], truth - before[1])
        before = image, truth
        if len(terms) == method.config.bptt:
            yield torch.stack(terms).mean()
            terms, before = [], (image.detach(), truth)
    if terms:
        yield torch.stack(terms).mean()


@dataclass(frozen=True)
class SharpnessRecorder:
    """A method while it is trained: how sharp its kernels are is written down."""

    method: Imcd
    strain: list[Tensor] = field(default_factory=list)  # mean a^2 + b^2 of each frame

    @property
    def traits(self) -> Traits:
        """Those of the method."""
        return self.method.traits

    def start(self, size: Size) -> State:
        """As the method's."""
        return self.method.start(size)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """As the method's."""
        return self.method.plan(gbuffer, samples, state)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """As the method's."""
        image, state, kernels = self.method.step(gbuffer, samples, state)
        self.strain.append(strain(kernels))
        return image, state


def strain(kernels: Kernels) -> Float[Tensor, ""]:
    """Mean over pixels of a^2, itself the mean over passes, plus b^2."""
    return kernels.sharpness.square().mean() + kernels.past_sharpness.square().mean()
