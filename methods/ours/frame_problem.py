"""One frame as an allocation problem: the sampler of `ours` acts, its denoiser answers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from methods.ours.method import Ours
from methods.ours.policy import Rollout
from methods.ours.state import RecurrentState
from rlbench.frames import Frame, GBuffer, Pool, Samples
from rlbench.ops.losses import log_transfer_loss
from rlbench.ops.transfer import log_forward
from rlbench.sampling import draw_samples
from rlbench.sanitize import SanitizedPool, sanitize_frame
from rlbench.training.surrogate_gradient import SampleGradient, relaxed_counts

__all__ = ["FrameProblem", "FrameStep"]


class FrameStep(NamedTuple):
    """The result of one action."""

    errors: Float[Tensor, "n 1 h w"]  # squared error in log transfer, mean over colours
    counts: Float[Tensor, "n 1 h w"]  # samples drawn
    state: RecurrentState  # for the next frame


@dataclass(frozen=True)
class FrameProblem:
    """An AllocationProblem (`policy/interface.py`) made of a frame, a state and a budget."""

    method: Ours
    frame: Frame
    gbuffer: GBuffer  # the inputs that the method declares
    state: RecurrentState
    spp: float

    @classmethod
    def of_frame(
        cls, method: Ours, frame: Frame, state: RecurrentState, spp: float
    ) -> FrameProblem:
        """The problem of a frame, with the inputs that the method declares, sanitised."""
        gbuffer = sanitize_frame(frame, method.traits.inputs).gbuffer
        return cls(method, frame, gbuffer, state, spp)

    @property
    def min_samples(self) -> int:
        """Fewest samples of a pixel."""
        return self.method.traits.min_samples

    @property
    def max_samples(self) -> int:
        """Most samples of a pixel: a limit of the method, or what the pool holds."""
        limit, stored = self.method.traits.max_samples, self.frame.pool.max_samples
        return stored if limit is None else min(limit, stored)

    @property
    def multiplicative(self) -> bool:
        """Does a step of the action multiply the density by a factor, or add to it?"""
        return self.method.action_density.multiplicative

    @property
    def observation(self) -> Float[Tensor, "n c h w"]:
        """The sampler's inputs, without gradient."""
        with torch.no_grad():
            return self.method.reproject(self.gbuffer, self.state).sampler_inputs

    def act(self) -> Float[Tensor, "n 1 h w"]:
        """The sampler's mean action."""
        return self.method.act(self.gbuffer, self.state)

    def relaxed_counts(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
        """Samples per pixel before rounding."""
        density = self._density(action)
        low = torch.full_like(density, self.min_samples)
        return relaxed_counts(
            density / density.detach().amax((2, 3), keepdim=True), self.spp, low, self.max_samples
        )

    def draw_counts(self, action: Float[Tensor, "n 1 h w"]) -> Int[Tensor, "n 1 h w"]:
        """Relaxed counts rounded at random, at the exact budget."""
        return self._draw_samples(action).counts

    @torch.no_grad()
    def evaluate_counts(self, counts: Int[Tensor, "k n 1 h w"]) -> Float[Tensor, "k n 1 h w"]:
        """Squared errors in log transfer of k sets of counts."""
        samples = (Samples(self._pool.read(self._pool.empty(), each), each) for each in counts)
        return torch.stack([self._denoise(each).errors for each in samples])

    @torch.no_grad()
    def rollout(self, actions: Float[Tensor, "k n 1 h w"]) -> Rollout:
        """Squared errors in log transfer, and counts, of k actions."""
        steps = [self.step(action) for action in actions]
        return Rollout(
            torch.stack([step.errors for step in steps]),
            torch.stack([step.counts for step in steps]),
        )

    @torch.no_grad()
    def step(self, action: Float[Tensor, "n 1 h w"]) -> FrameStep:
        """Draw samples by an action, denoise them, and compare the image with the reference."""
        return self._denoise(self._draw_samples(action))

    def _denoise(self, samples: Samples) -> FrameStep:
        image, state = self.method.denoise(self.gbuffer, samples, self.state)
        error = (log_forward(image).clamp(0, 1) - self._truth).square().mean(1, keepdim=True)
        return FrameStep(error, samples.counts.float(), state)

    @torch.no_grad()
    def render(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 3 h w"]:
        """The denoised image of an action, linear radiance."""
        samples = self._draw_samples(action)
        return self.method.denoise(self.gbuffer, samples, self.state)[0]

    def surrogate_loss(self, sample_gradient: SampleGradient) -> Float[Tensor, ""]:
        """The loss of the mean action's image, with a gradient to the action through the samples.

        The gradient reaches the sampler alone. Encoder and denoiser learn from the training image.
        """
        action = self.act()
        samples = sample_gradient(
            self._draw_samples(action.detach()), self.relaxed_counts(action), self.frame
        )
        with freeze(self.method.networks.encoder, self.method.networks.denoiser):
            image, _ = self.method.denoise(self.gbuffer, samples, self.state)
        return log_transfer_loss(image, self.frame.reference.mean)

    @cached_property
    def _truth(self) -> Float[Tensor, "n 3 h w"]:
        return log_forward(self.frame.reference.mean).clamp(0, 1)

    @cached_property
    def _pool(self) -> Pool:
        return SanitizedPool(self.frame.pool, Counter())

    def _draw_samples(self, action: Float[Tensor, "n 1 h w"]) -> Samples:
        pool, density = self._pool, self._density(action)
        return draw_samples(
            pool, pool.empty(), density, self.spp, self.min_samples, self.max_samples
        )

    def _density(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
        return self.method.to_density(action, self.gbuffer, self.state)


@contextmanager
def freeze(*modules: nn.Module | None) -> Iterator[None]:
    """Within this context no gradient reaches the modules' weights; it passes through to inputs."""
    trainable = [w for m in modules if m is not None for w in m.parameters() if w.requires_grad]
    for weight in trainable:
        weight.requires_grad_(False)
    try:
        yield
    finally:
        for weight in trainable:
            weight.requires_grad_(True)
