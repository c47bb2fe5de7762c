"""One frame of the proposed method: plan by what is remembered, encode what was bought, denoise."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from baselines.oidn.method import inputs
from methods.ours import FAMILY
from methods.ours.accumulation import accumulate, fill_holes, frame_radiance
from methods.ours.antilag import history_confidence
from methods.ours.networks import Networks
from methods.ours.state import (
    MISSING,
    FrameContext,
    History,
    RecurrentState,
    ReprojectedHistory,
    gbuffer_features,
    initial_state,
    reproject_state,
)
from methods.ours.variants import SLOTS, VARIANTS, Config, Density
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.demodulation import sanitize_radiance
from rlbench.ops.exposure import autoexposure
from rlbench.ops.init import kaiming_init
from rlbench.ops.memory_format import to_contiguous_float32
from rlbench.ops.padding import crop, pad
from rlbench.ops.transfer import (
    LOG_SCALE,
    log_forward,
    log_inverse,
    pu_inverse,
)
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"
BELOW = -0.5 / LOG_SCALE  # least radiance while it trains; log transfer is defined above twice it
SPAN = 1.5  # logarithm of the density of action 1, that of action 0 being 0
MULTIPLE = 16  # sides that the denoiser can halve four times


@dataclass(frozen=True)
class Ours:
    """Scardigli et al. 2023: sampler on the warped state, encoder of raw samples, denoiser.

    Differs from the paper, in `ours/paper` too: the density is the action above the lower end of
    its range (x + 1, x in [-1, 1]) and not above the frame's least action, which is an outlier of
    half a million values; networks see linear radiance through a logarithm where the authors' data
    was 8-bit sRGB; a state that comes from outside the image is marked by an exact mask, not by a
    magic zero.

    Differs in all but `ours/paper`: the denoiser reads colour, albedo and normal in the way of Open
    Image Denoise (Afra 2019), and then the state, and starts from Intel's weights, where there are
    any of its size. In all but B1 and B2 besides: beside the state there is light, gathered over
    frames, of which the encoder says how far it is trusted; the denoiser says how much of the last
    image is kept; new samples that contradict them make both forgotten (antilag.py); sampler and
    encoder also see that light and that image. A pixel that stands still and got no sample keeps
    its state and its light. The sampler is told how many samples the last frame got, and how far
    its map is from uniform follows from that.
    """

    config: Config
    traits: Traits
    networks: Networks
    context_cache: dict[str, tuple[GBuffer, RecurrentState, FrameContext]] = field(
        default_factory=dict, repr=False, compare=False
    )

    def start(self, size: Size) -> RecurrentState:
        """No memory."""
        return initial_state(self.config, size, next(self.networks.parameters()).device)

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: RecurrentState
    ) -> Float[Tensor, "n 1 h w"]:
        """The density of the sampler's action; constant where there is none, or it is ignored."""
        if self.networks.sampler is None or self.config.flat:
            return torch.ones_like(gbuffer.depth)
        return self.density(self.act(gbuffer, state))

    def density(self, action: Float[Tensor, "*k n 1 h w"]) -> Float[Tensor, "*k n 1 h w"]:
        """How much is wished for by an action; actions beyond [-1, 1] are clamped."""
        return density(action, self.config.density)

    def act(self, gbuffer: GBuffer, state: RecurrentState) -> Float[Tensor, "n 1 h w"]:
        """The sampler's mean action, in [-1, 1]."""
        assert self.networks.sampler is not None
        seen = self.known(gbuffer, state).sampler_input
        h, w = seen.shape[-2:]
        action: Tensor = self.networks.sampler(pad(seen, MULTIPLE))
        return crop(action, h, w).float()

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: RecurrentState
    ) -> tuple[Float[Tensor, "n 3 h w"], RecurrentState]:
        """The image in linear radiance, and what is left for the next frame."""
        samples = replace(samples, radiance=sanitize_radiance(samples.radiance))
        known, values = self.known(gbuffer, state), self._values(samples)
        latent, trust = self._encode(gbuffer, values, known, samples.counts)
        past = None
        if self.config.light == "none":
            image = log_inverse(self._run_denoiser(latent))
        else:
            light, moved = frame_radiance(samples), known.moved
            if moved is not None:
                if self.config.antilag:
                    moved = moved.with_confidence(
                        history_confidence(moved.light, light, moved.image)
                    )
                light = accumulate(moved.light, light, trust)
            light = fill_holes(light, gbuffer.albedo)
            image = self._reconstruct(gbuffer, light.mean, latent, moved)
            spent = samples.counts.float().mean((1, 2, 3), keepdim=True)
            past = (
                History(light, image, gbuffer_features(gbuffer), spent)
                if self.config.gathers
                else None
            )
        kept = {"state": latent, "samples": values, "nothing": latent[:, :0]}
        return image, RecurrentState(kept[self.config.remembers], past, state.age + 1)

    def known(self, gbuffer: GBuffer, state: RecurrentState) -> FrameContext:
        """What is remembered, moved to where it is now, beside the view.

        Kept from planning a frame to denoising it, which ask for the same; not while it trains.
        """
        if torch.is_grad_enabled():
            return reproject_state(self.config, gbuffer, state)
        last = self.context_cache.get("known")
        if last is None or last[0] is not gbuffer or last[1] is not state:
            last = self.context_cache["known"] = (
                gbuffer,
                state,
                reproject_state(self.config, gbuffer, state),
            )
        return last[2]

    def _values(self, samples: Samples) -> Float[Tensor, "n c h w"]:
        """Samples in log transfer, MISSING where there is none: each by itself, or their mean."""
        if self.config.samples == "single":
            values = log_forward(samples.radiance).where(samples.valid_mask, MISSING)  # n s 3 h w
            short = SLOTS - values.shape[1]
            return F.pad(values, (0,) * 7 + (short,), value=MISSING).flatten(1, 2)
        mean = log_forward(samples.mean).where(samples.counts > 0, MISSING)
        if self.config.samples == "mean":
            return mean
        return torch.cat((mean, samples.counts / SLOTS), dim=1)

    def _encode(
        self,
        gbuffer: GBuffer,
        values: Float[Tensor, "n c h w"],
        known: FrameContext,
        counts: Int[Tensor, "n 1 h w"],
    ) -> tuple[Float[Tensor, "n s h w"], Float[Tensor, "n 1 h w"]]:
        """The new state and how far light gathered before is trusted, in [0, 1].

        Where light is gathered, a pixel that stands still and got no sample keeps both as they are.
        """
        if self.networks.encoder is None:
            return torch.cat((values, gbuffer_features(gbuffer)), dim=1), torch.zeros_like(
                gbuffer.depth
            )
        seen = torch.cat((values, known.seen), dim=1)
        h, w = seen.shape[-2:]
        encoded = crop(to_contiguous_float32(self.networks.encoder(pad(seen, MULTIPLE))), h, w)
        latent, rest = encoded[:, : self.config.latent], encoded[:, self.config.latent :]
        trust = (1 + rest) / 2
        if known.moved is None:
            return latent, trust
        kept = known.moved.static_mask & (counts == 0)
        return known.moved.state.where(kept, latent), trust.masked_fill(kept, 1.0)

    def _reconstruct(
        self,
        gbuffer: GBuffer,
        colour: Float[Tensor, "n 3 h w"],
        latent: Float[Tensor, "n s h w"],
        moved: ReprojectedHistory | None,
    ) -> Float[Tensor, "n 3 h w"]:
        """The image that Intel's network makes of a colour and the state, and of the last image."""
        exposure = autoexposure(colour.detach())
        value = self._run_denoiser(torch.cat((inputs(colour * exposure, gbuffer), latent), dim=1))
        image = (pu_inverse(value[:, :3].clamp_max(1)) / exposure).clamp_min(BELOW)
        if moved is None:
            return image
        kept = value[:, 3:].sigmoid() * moved.similarity
        return log_inverse(torch.lerp(log_forward(image), moved.image, kept))

    def _run_denoiser(self, shown: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c2 h w"]:
        """What the denoiser says, in its transfer space; colour below zero only while it trains."""
        h, w = shown.shape[-2:]
        value = crop(to_contiguous_float32(self.networks.denoiser(pad(shown, MULTIPLE))), h, w)
        if self.networks.training:
            return value
        return torch.cat((value[:, :3].clamp_min(0), value[:, 3:]), dim=1)


def density(action: Float[Tensor, "*k n 1 h w"], kind: Density) -> Float[Tensor, "*k n 1 h w"]:
    """Of an action in [-1, 1]: how far it lies above the lowest, or a share that grows by factors.

    Where it grows by factors, equal steps of the action are equal steps in relative count, at both
    ends of the range alike, and nothing is wished not to be sampled at all.
    """
    action = action.clamp(-1, 1)
    return torch.exp(SPAN * action) if kind == "exponential" else 1 + action


def build(variant: str, device: torch.device, weights: str | None) -> Ours:
    """The method `ours` or `ours/VARIANT`, with shipped weights, a file's, or random ones."""
    config = VARIANTS[variant]
    networks = Networks(config)
    if weights == "random":
        kaiming_init(networks)
    load_for_inference(networks, weights, CARDS / FAMILY.weights(variant), device)
    return Ours(config, FAMILY.variants[variant].traits, networks)
