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
from methods.ours.policy import Trial
from methods.ours.state import Memory
from rlbench.frames import Frame, Samples, View
from rlbench.ops.losses import mixed
from rlbench.ops.transfer import log_forward
from rlbench.sampling import buy, nothing
from rlbench.training.surrogate_gradient import Teach, shares


@dataclass(frozen=True)
class Turn:
    """A situation (`policy/interface.py`): the frame, what was remembered, the budget."""

    method: Ours
    frame: Frame
    view: View  # with what the method declared
    state: Memory
    spp: float

    @property
    def factors(self) -> bool:
        """Does the density grow by factors with the action?"""
        return self.method.config.density == "exponential"

    @property
    def seen(self) -> Float[Tensor, "n c h w"]:
        """What the sampler sees."""
        with torch.no_grad():
            return self.method.known(self.view, self.state).foreseen

    def act(self) -> Float[Tensor, "n 1 h w"]:
        """The sampler's mean action."""
        return self.method.act(self.view, self.state)

    def relaxed(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
        """Samples a pixel that are due, before rounding."""
        wish = self.method.density(action)
        low = torch.full_like(wish, self.method.traits.floor)
        return shares(wish / wish.detach().amax((2, 3), keepdim=True), self.spp, low, self._cap())

    @torch.no_grad()
    def attempt(self, actions: Float[Tensor, "k n 1 h w"]) -> Trial:
        """Squared errors in log transfer, and counts."""
        errors, counts, _ = zip(*(self.take(action) for action in actions), strict=True)
        return Trial(torch.stack(errors), torch.stack(counts))

    @torch.no_grad()
    def take(
        self, action: Float[Tensor, "n 1 h w"]
    ) -> tuple[Float[Tensor, "n 1 h w"], Float[Tensor, "n 1 h w"], Memory]:
        """Squared errors in log transfer, counts, and what is left for the next frame."""
        image, samples, left = self.show(action)
        error = (log_forward(image).clamp(0, 1) - self._truth).square().mean(1, keepdim=True)
        return error, samples.counts.float(), left

    @torch.no_grad()
    def show(
        self, action: Float[Tensor, "n 1 h w"]
    ) -> tuple[Float[Tensor, "n 3 h w"], Samples, Memory]:
        """The image of an action, what was bought for it, and what is left for the next frame."""
        samples = self._buy(action)
        image, left = self.method.denoise(self.view, samples, self.state)
        return image, samples, left

    def slope(self, teach: Teach) -> Float[Tensor, ""]:
        """The loss of the mean action's image, with a gradient to the action through samples.

        It reaches the sampler alone: the others learn by the image that is shown.
        """
        action = self.act()
        samples = teach(self._buy(action.detach()), self.relaxed(action), self.frame)
        with frozen(self.method.networks.encoder, self.method.networks.denoiser):
            image, _ = self.method.denoise(self.view, samples, self.state)
        return mixed(log_forward(image), log_forward(self.frame.reference.mean))

    @cached_property
    def _truth(self) -> Float[Tensor, "n 3 h w"]:
        return log_forward(self.frame.reference.mean).clamp(0, 1)

    def _buy(self, action: Float[Tensor, "n 1 h w"]) -> Samples:
        pool, floor = self.frame.pool, self.method.traits.floor
        return buy(pool, nothing(pool), self.method.density(action), self.spp, floor, self._cap())

    def _cap(self) -> int:
        cap = self.method.traits.cap
        return self.frame.pool.cap if cap is None else min(cap, self.frame.pool.cap)


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
