"""One frame in which the sampler of `ours` has to act, with its denoiser behind it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor, nn

from methods.ours.method import Ours
from methods.ours.policy import Rollout
from methods.ours.state import RecurrentState
from rlbench.frames import Frame, GBuffer, Samples
from rlbench.ops.losses import l1_ms_ssim_loss
from rlbench.ops.transfer import log_forward
from rlbench.sampling import draw_samples
from rlbench.training.surrogate_gradient import SampleGradient, relaxed_counts


@dataclass(frozen=True)
class FrameProblem:
    """A situation (`policy/interface.py`): the frame, what was remembered, the budget."""

    method: Ours
    frame: Frame
    gbuffer: GBuffer  # with what the method declared
    state: RecurrentState
    spp: float

    @property
    def multiplicative(self) -> bool:
        """Does the density grow by factors with the action?"""
        return self.method.config.density == "exponential"

    @property
    def seen(self) -> Float[Tensor, "n c h w"]:
        """What the sampler sees."""
        with torch.no_grad():
            return self.method.known(self.gbuffer, self.state).sampler_input

    def act(self) -> Float[Tensor, "n 1 h w"]:
        """The sampler's mean action."""
        return self.method.act(self.gbuffer, self.state)

    def relaxed(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
        """Samples a pixel that are due, before rounding."""
        wish = self.method.density(action)
        low = torch.full_like(wish, self.method.traits.min_samples)
        return relaxed_counts(
            wish / wish.detach().amax((2, 3), keepdim=True), self.spp, low, self._cap()
        )

    @torch.no_grad()
    def rollout(self, actions: Float[Tensor, "k n 1 h w"]) -> Rollout:
        """Squared errors in log transfer, and counts."""
        errors, counts, _ = zip(*(self.take(action) for action in actions), strict=True)
        return Rollout(torch.stack(errors), torch.stack(counts))

    @torch.no_grad()
    def take(
        self, action: Float[Tensor, "n 1 h w"]
    ) -> tuple[Float[Tensor, "n 1 h w"], Float[Tensor, "n 1 h w"], RecurrentState]:
        """Squared errors in log transfer, counts, and what is left for the next frame."""
        image, samples, left = self.show(action)
        error = (log_forward(image).clamp(0, 1) - self._truth).square().mean(1, keepdim=True)
        return error, samples.counts.float(), left

    @torch.no_grad()
    def show(
        self, action: Float[Tensor, "n 1 h w"]
    ) -> tuple[Float[Tensor, "n 3 h w"], Samples, RecurrentState]:
        """The image of an action, what was bought for it, and what is left for the next frame."""
        samples = self._buy(action)
        image, left = self.method.denoise(self.gbuffer, samples, self.state)
        return image, samples, left

    def surrogate_loss(self, teach: SampleGradient) -> Float[Tensor, ""]:
        """The loss of the mean action's image, with a gradient to the action through samples.

        It reaches the sampler alone: the others learn by the image that is shown.
        """
        action = self.act()
        samples = teach(self._buy(action.detach()), self.relaxed(action), self.frame)
        with frozen(self.method.networks.encoder, self.method.networks.denoiser):
            image, _ = self.method.denoise(self.gbuffer, samples, self.state)
        return l1_ms_ssim_loss(log_forward(image), log_forward(self.frame.reference.mean))

    @cached_property
    def _truth(self) -> Float[Tensor, "n 3 h w"]:
        return log_forward(self.frame.reference.mean).clamp(0, 1)

    def _buy(self, action: Float[Tensor, "n 1 h w"]) -> Samples:
        pool, floor = self.frame.pool, self.method.traits.min_samples
        return draw_samples(
            pool, pool.empty(), self.method.density(action), self.spp, floor, self._cap()
        )

    def _cap(self) -> int:
        cap = self.method.traits.max_samples
        return self.frame.pool.max_samples if cap is None else min(cap, self.frame.pool.max_samples)


@contextmanager
def frozen(*modules: nn.Module | None) -> Iterator[None]:
    """No gradient reaches the weights of what is run in here; it passes through."""
    learning = [w for m in modules if m is not None for w in m.parameters() if w.requires_grad]
    for weight in learning:
        weight.requires_grad_(False)
    try:
        yield
    finally:
        for weight in learning:
            weight.requires_grad_(True)
