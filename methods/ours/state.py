"""What `ours` remembers from frame to frame, and what it knows of a frame before it is sampled."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from methods.ours.accumulation import AccumulatedRadiance, feature_similarity, network_features
from methods.ours.networks import VIEW
from methods.ours.variants import SAMPLES, Config
from rlbench.frames import GBuffer, Size
from rlbench.ops.reprojection import reproject, reproject_bicubic
from rlbench.ops.transfer import log_forward, squash_depth

MISSING = -1.0  # a sample that was not bought, a state that is not there
STILL = 1e-3  # pixels: what moves by less stands still
SAME = 0.5  # least likeness (0 to 1) of what was there and what is, for it to be the same thing
LEAST = 0.01  # samples a pixel; a smaller budget is taken for this one
SHARP = [3, 1, 3]  # channels of what is kept of the past: mean, square, last image
SOFT = [1, VIEW]  # and weight, view


class History(NamedTuple):
    """What is kept of the frames before, beside the state, where light is gathered."""

    light: AccumulatedRadiance
    image: Float[Tensor, "n 3 h w"]  # the last one, linear radiance
    seen: Float[Tensor, "n 7 h w"]  # the last view
    previous_spp: Float[Tensor, "n 1 1 1"]  # samples a pixel of the last frame; 1 before the first


class RecurrentState(NamedTuple):
    """What one frame leaves for the next; of no frames it has age 0 and is empty."""

    state: Float[Tensor, "n c h w"]  # latent, or samples; MISSING everywhere before the first frame
    past: History | None  # None where the variant gathers no light
    age: int  # frames


class ReprojectedHistory(NamedTuple):
    """What was kept of the frames before, where it is now."""

    state: Float[Tensor, "n c h w"]  # MISSING where it is from outside
    light: AccumulatedRadiance  # without weight there
    image: Float[Tensor, "n 3 h w"]  # in log transfer
    similarity: Float[Tensor, "n 1 h w"]  # how much what was there is what is here
    static_mask: Bool[Tensor, "n 1 h w"]  # was the same thing there already?

    def with_confidence(self, share: Float[Tensor, "n 1 h w"]) -> ReprojectedHistory:
        """The same, with so much of the light's weight and of the last image."""
        light = self.light._replace(accumulated_spp=self.light.accumulated_spp * share)
        return self._replace(light=light, similarity=self.similarity * share)


class FrameContext(NamedTuple):
    """What is known of a frame before it is sampled."""

    seen: Float[Tensor, "n c h w"]  # by the networks
    moved: ReprojectedHistory | None
    previous_spp: Float[Tensor, "n 1 1 1"] | None = None  # where light is gathered

    @property
    def sampler_input(self) -> Float[Tensor, "n c h w"]:
        """What the sampler sees: last, where light is gathered, the logarithm of the budget.

        That is how many samples a pixel the last frame got.
        """
        if self.previous_spp is None:
            return self.seen
        budget = self.previous_spp.clamp_min(LEAST).log().expand(-1, -1, *self.seen.shape[-2:])
        return torch.cat((self.seen, budget), dim=1)


def detached(memory: RecurrentState) -> RecurrentState:
    """The same, through which no gradient flows."""
    if (past := memory.past) is not None:
        light = AccumulatedRadiance(*(part.detach() for part in past.light))
        past = History(light, past.image.detach(), past.seen.detach(), past.previous_spp)
    return RecurrentState(memory.state.detach(), past, memory.age)


def initial_state(config: Config, size: Size, device: torch.device) -> RecurrentState:
    """No memory: the sentinel everywhere."""
    n, h, w = size
    channels = {"state": config.latent, "samples": SAMPLES[config.samples]}
    sharp, soft = (torch.zeros(n, sum(x), h, w, device=device) for x in (SHARP, SOFT))
    state = sharp.new_full((n, channels.get(config.remembers, 0), h, w), MISSING)
    once = torch.ones(n, 1, 1, 1, device=device)
    return RecurrentState(state, _past(sharp, soft, once) if config.gathers else None, 0)


def reproject_state(config: Config, gbuffer: GBuffer, state: RecurrentState) -> FrameContext:
    """What is remembered, moved to where it is now, beside the view."""
    seen = gbuffer_features(gbuffer)
    if config.remembers == "nothing":
        return FrameContext(seen, None)
    state = state if state.age % config.bptt else detached(state)
    width, history = state.state.shape[1], state.state
    if state.past is not None:
        history = torch.cat((history, state.past.light.accumulated_spp, state.past.seen), dim=1)
    soft, valid = reproject(history, gbuffer.motion)
    valid = valid & (state.age > 0)
    remembered = soft[:, :width].where(valid, MISSING)
    if state.past is None:
        return FrameContext(torch.cat((seen, remembered), dim=1), None)
    light, image = state.past.light, log_forward(state.past.image)
    sharp, _ = reproject_bicubic(
        torch.cat((light.mean, light.second_moment, image), dim=1), gbuffer.motion
    )
    shot = valid.any(dim=3, keepdim=True).any(dim=2, keepdim=True)  # is anything left of it?
    # its image is in log transfer from here on: linear, taps beside a lamp would be all rounding
    past = _past(sharp, soft[:, width:], state.past.previous_spp.where(shot, 1.0))
    same = feature_similarity(seen, past.seen).where(valid, 0.0)
    light = past.light._replace(accumulated_spp=past.light.accumulated_spp * same)
    gained = torch.cat((past.image, network_features(light), same), dim=1).where(valid, MISSING)
    every = torch.cat((seen, remembered, gained), dim=1)
    if gbuffer.motion is not None:
        valid = valid & (gbuffer.motion.abs().amax(1, keepdim=True) < STILL)
    valid = valid & (same > SAME)
    return FrameContext(
        every, ReprojectedHistory(remembered, light, past.image, same, valid), past.previous_spp
    )


def gbuffer_features(gbuffer: GBuffer) -> Float[Tensor, "n 7 h w"]:
    """A view as networks see it: normal, albedo, 1 / (1 + depth)."""
    return torch.cat((gbuffer.normal, gbuffer.albedo, squash_depth(gbuffer.depth)), dim=1)


def _past(
    sharp: Float[Tensor, "n 7 h w"], soft: Float[Tensor, "n 8 h w"], spent: Float[Tensor, "n 1 1 1"]
) -> History:
    mean, square, image = sharp.split_with_sizes(SHARP, 1)
    weight, seen = soft.split_with_sizes(SOFT, 1)
    return History(AccumulatedRadiance(mean, square, weight), image, seen, spent)
