"""Training both networks jointly: what was bought gets a gradient that reaches the map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from baselines.ntas import FAMILY
from baselines.ntas.method import LOWEST, Ntas
from baselines.ntas.network import Networks
from rlbench.family import Traits
from rlbench.frames import Clip, Size, View
from rlbench.method import Method
from rlbench.ops.transfer import log_forward
from rlbench.run import unroll
from rlbench.sampling import Samples
from rlbench.training import Trainer

SPP = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)  # budgets, samples per pixel, one drawn a sequence
BISECTIONS = 32  # of the logarithm of a multiplier, some 30 wide: exact to float32
NONE = 1e-20  # below any density: keeps the share of no pixel from dividing by zero


def trainer(variant: str, device: torch.device, seed: int) -> Trainer:
    """NTAS with seeded weights, and the loss that trains sampler and denoiser together.

    L1 of the image plus L1 of its change since the last frame, both against the reference's and
    in log transfer, weights 1 and 1. Hasselgren et al. 2020 take the last frames of a sequence,
    here it is all frames of each `bptt`; their transfer is not known to us.
    """
    networks = Networks()
    networks.draw(seed)
    networks.to(device)
    method = Ntas(networks, traits=FAMILY.variants[variant].traits)

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        return _losses(method, clip, spp)

    return Trainer(method, networks, losses, SPP)


def _losses(method: Ntas, clip: Clip, spp: float) -> Iterator[Tensor]:
    references = (frame.reference.mean for frame in clip)
    taught = Surrogate(method, references, spp)
    terms: list[Tensor] = []  # of the frames since the last yield
    before: tuple[Tensor, Tensor] | None = None  # image and reference of the last frame
    for shown in unroll(taught, clip, spp):
        image, truth = log_forward(shown.image), log_forward(shown.frame.reference.mean)
        terms.append(F.l1_loss(image, truth))
        if before is not None:
            terms[-1] = terms[-1] + F.l1_loss(image - before[0], truth - before[1])
        before = image, truth
        if len(terms) == method.config.bptt:
            yield torch.stack(terms).mean()
            terms, before = [], (image.detach(), truth)
    if terms:
        yield torch.stack(terms).mean()


@dataclass
class Surrogate:
    """A method while it is trained: its samples carry a gradient back to the density it asked for.

    One sample more would move the mean I of a pixel's s samples towards the truth T, on average
    by (T - I) / s: that is taken as dI/ds, as by Kuznetsov et al. 2018, Deep Adaptive Sampling for
    Low Sample Count Rendering. (T - I) is divided by the count that was bought; s is the share that
    was due before rounding. Its normalisation is differentiated too, pixels held at a bound get no
    gradient, and rounding is passed over. The truth is the trainer's: it is in the gradient alone,
    and the method sees the values that it would see without it. For a quadratic error the estimate
    is twice the true derivative.
    """

    method: Method
    references: Iterator[Float[Tensor, "n 3 h w"]]  # of the frames to come, in order
    spp: float  # budget, samples per pixel
    density: Tensor | None = None  # what was last asked for

    @property
    def traits(self) -> Traits:
        """Those of the method."""
        return self.method.traits

    def start(self, size: Size) -> Any:
        """As the method's."""
        return self.method.start(size)

    def plan(self, view: View, samples: Samples, state: Any) -> Float[Tensor, "n 1 h w"]:
        """As the method's; remembered, with its graph, until the samples are here."""
        self.density = self.method.plan(view, samples, state)
        return self.density

    def denoise(
        self, view: View, samples: Samples, state: Any
    ) -> tuple[Float[Tensor, "n 3 h w"], Any]:
        """As the method's, on samples with equal values and a gradient to the density."""
        assert self.density is not None, "denoise before plan"
        high = samples.radiance.shape[1]
        due = shares(self.density, self.spp, self.traits.floor, high)
        samples = teach(samples, due, next(self.references))
        return self.method.denoise(view, samples, state)


def teach(
    samples: Samples, due: Float[Tensor, "n 1 h w"], truth: Float[Tensor, "n 3 h w"]
) -> Samples:
    """The same samples, with d mean / d due = (truth - mean) / counts; every count is >= 1."""
    nought = due - due.detach()  # zero, but with a gradient
    first = samples.radiance[:, 0] + nought * (truth - samples.mean).detach()
    return replace(samples, radiance=torch.cat((first[:, None], samples.radiance[:, 1:]), 1))


def shares(
    density: Float[Tensor, "n 1 h w"], spp: float, low: int, high: int
) -> Float[Tensor, "n 1 h w"]:
    """clip(k * density, low, high), differentiable, with the k at which its mean is `spp`.

    Pixels strictly within the bounds share, in proportion to density, what the others leave; so k
    is differentiated too. At `spp` = `low` there are none, and no gradient.
    Density in [exp(-30), 1], as from `Ntas.plan`; low > 0.
    """
    with torch.no_grad():
        below = torch.full_like(density[:, :, :1, :1], math.log(low))
        above = below + math.log(high / low) - LOWEST
        for _ in range(BISECTIONS):
            middle = (below + above) / 2
            over = _clip(density, middle, low, high).mean((2, 3), keepdim=True) > spp
            below, above = torch.where(over, below, middle), torch.where(over, middle, above)
        held = _clip(density, below, low, high)
        free = (held > low) & (held < high)
        left = (held * free).sum((2, 3), keepdim=True)
    wanted = density * free
    scale = left / wanted.sum((2, 3), keepdim=True).clamp_min(NONE)
    return torch.where(free, wanted * scale, held)


def _clip(density: Tensor, log_k: Tensor, low: int, high: int) -> Tensor:
    return (density * log_k.exp()).clamp(low, high)
