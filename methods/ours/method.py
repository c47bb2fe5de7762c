"""One frame of the proposed method: reproject, encode, accumulate, reconstruct, remember."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor

from baselines.accumulate.density import contrast, mix_with_uniform
from methods.ours import FAMILY, VARIANTS, Config
from methods.ours.accumulators import (
    Accumulator,
    FrameRadiance,
    RuleRadiance,
    SampledFrame,
    StateOnly,
    TemporalRadiance,
    hold_static,
)
from methods.ours.history import (
    DenoisedFrame,
    FeatureHistory,
    RadianceHistory,
    RecurrentState,
    ReprojectedHistory,
    gbuffer_features,
)
from methods.ours.initialization import initialize
from methods.ours.networks import SAMPLE_ENCODINGS, Networks, Sampler, history_features
from rlbench.family import Family, Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.asking import next_age
from rlbench.ops.fireflies import limit_fireflies
from rlbench.ops.init import kaiming_init
from rlbench.ops.memory_format import to_contiguous_float32
from rlbench.ops.padding import crop, pad
from rlbench.ops.reprojection import ReprojectionMemo
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"
MULTIPLE = 16  # pixels; the denoiser halves the image four times
LOG_RANGE = 1.5  # logarithm of the exponential density of action 1; action 0 has density 1


def exponential_density(action: Float[Tensor, "*k n 1 h w"]) -> Float[Tensor, "*k n 1 h w"]:
    """Density exp(1.5 action), for actions clamped to [-1, 1]: no pixel is excluded.

    Equal steps of the action are equal relative changes of the count, at both ends of the range.

    >>> exponential_density(torch.zeros(1, 1, 1, 2))
    tensor([[[[1., 1.]]]])
    """
    return torch.exp(LOG_RANGE * action.clamp(-1, 1))


def linear_density(action: Float[Tensor, "*k n 1 h w"]) -> Float[Tensor, "*k n 1 h w"]:
    """Density 1 + action: the height above the lowest possible action, as in `ours/paper`."""
    return 1 + action.clamp(-1, 1)


DENSITIES: Mapping[str, Callable[[Tensor], Tensor]] = {
    "exponential": exponential_density,
    "linear": linear_density,
}


@dataclass(frozen=True)
class Ours:
    """Scardigli et al. 2023: sampler on the reprojected state, encoder of raw samples, denoiser.

    Differs from the paper, in `ours/paper` too: the density is the action above the lower end of
    its range (x + 1, x in [-1, 1]), where the paper subtracts the frame's least action, an outlier
    of half a million values; networks read linear radiance through a logarithm, where the authors'
    data was 8-bit sRGB; history from outside the image is marked by an exact mask, where the
    release marks it by a value.

    Differs from the paper in all variants but `ours/paper*`: the denoiser reads colour, albedo and
    normal as Open Image Denoise (Afra 2019) does, followed by the state, and starts from Intel's
    weights where Intel has a network of its size. Also, in all but B1 and B2: radiance is
    accumulated beside the state, with a trust that the encoder predicts; the denoiser predicts how
    far the previous image is kept; new samples that contradict both reduce both
    (rlbench.ops.antilag); sampler and encoder read both. A static pixel trusts its radiance in
    full, so that a still camera converges; without samples it keeps its state too. The sampler
    reads the spp of the previous frame, by which it scales the contrast of its map. Fireflies are
    limited (rlbench.ops.limit_fireflies), and a pixel of broken history is replaced by a neighbour.
    """

    config: Config  # recorded in results; the parts below follow from it, see `assemble`
    traits: Traits
    networks: Networks
    sampler: Sampler | None  # None samples uniformly
    history: FeatureHistory
    accumulator: Accumulator
    memo: ReprojectionMemo[ReprojectedHistory] = field(
        default_factory=ReprojectionMemo, repr=False, compare=False
    )

    def start(self, size: Size) -> RecurrentState:
        """The state before the first frame."""
        return self.history.start(size, next(self.networks.parameters()).device)

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: RecurrentState
    ) -> Float[Tensor, "n 1 h w"]:
        """The density of the sampler's action; that of action 0 without a sampler."""
        if self.sampler is None:
            return self.to_density(torch.zeros_like(gbuffer.depth), gbuffer, state)
        return self.to_density(self.act(gbuffer, state), gbuffer, state)

    def to_density(
        self, action: Float[Tensor, "*k n 1 h w"], gbuffer: GBuffer, state: RecurrentState
    ) -> Float[Tensor, "*k n 1 h w"]:
        """The density of an action, on top of the contrast rule's if the variant has one."""
        density = DENSITIES[self.config.density](action)
        if not self.config.contrast_density or state.age == 0:
            return density
        with torch.no_grad():
            history = self.reproject(gbuffer, state)
            rule = mix_with_uniform(contrast(history), history.similarity)
        return density * rule

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: RecurrentState
    ) -> tuple[Float[Tensor, "n 3 h w"], RecurrentState]:
        """The image in linear radiance, and the state for the next frame."""
        limited = limit_fireflies(samples.radiance, samples.counts)
        samples = replace(samples, radiance=limited)
        history = self.reproject(gbuffer, state)
        encoded = SAMPLE_ENCODINGS[self.config.sample_encoding].encode(samples)
        latent, trust = self._encode(gbuffer, encoded, samples.counts, history)
        radiance, sampled = self.accumulator.accumulate(
            SampledFrame(gbuffer, samples, history, latent, trust)
        )
        image, latent = self.accumulator.reconstruct(self._run_denoiser, sampled, radiance)
        frame = DenoisedFrame(gbuffer, samples, encoded, latent, radiance, image)
        if not self.traits.temporal:  # nothing is remembered
            return image, state
        return image, self.history.remember(frame, next_age(state.age))

    def act(self, gbuffer: GBuffer, state: RecurrentState) -> Float[Tensor, "n 1 h w"]:
        """The sampler's mean action, in [-1, 1]."""
        assert self.sampler is not None
        inputs = self.reproject(gbuffer, state).sampler_inputs
        h, w = inputs.shape[-2:]
        action: Tensor = self.sampler(pad(inputs, MULTIPLE))
        return crop(action, h, w).float()

    def reproject(self, gbuffer: GBuffer, state: RecurrentState) -> ReprojectedHistory:
        """The history at the pixels of the current frame."""
        return self.memo.get(gbuffer, state, self.history.reproject)

    def _encode(
        self,
        gbuffer: GBuffer,
        encoded: Float[Tensor, "n c h w"],
        counts: Int[Tensor, "n 1 h w"],
        history: ReprojectedHistory,
    ) -> tuple[Float[Tensor, "n s h w"], Float[Tensor, "n _ h w"]]:
        """The new latent, and the trust in accumulated radiance, in [0, 1].

        Without an encoder the latent is its input, samples and G-buffer features, or that of the
        previous frame if the denoiser writes it.
        """
        if self.networks.encoder is None:
            if self.config.denoiser_writes_latent:
                return history.features, history.features[:, :0]
            latent = torch.cat((encoded, gbuffer_features(gbuffer)), dim=1)
            return latent, latent[:, :0]
        inputs = torch.cat((encoded, history.inputs), dim=1)
        h, w = inputs.shape[-2:]
        output = crop(to_contiguous_float32(self.networks.encoder(pad(inputs, MULTIPLE))), h, w)
        latent, trust = output[:, : self.config.latent], (1 + output[:, self.config.latent :]) / 2
        if not self.config.accumulates:
            return latent, trust
        return hold_static(latent, trust, counts, history)

    def _run_denoiser(self, inputs: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c2 h w"]:
        """The denoiser's output; colour is clamped to >= 0 except during training."""
        h, w = inputs.shape[-2:]
        value = crop(to_contiguous_float32(self.networks.denoiser(pad(inputs, MULTIPLE))), h, w)
        if self.networks.training:
            return value
        return torch.cat((value[:, :3].clamp_min(0), value[:, 3:]), dim=1)


def assemble(config: Config, traits: Traits, networks: Networks) -> Ours:
    """The method with the parts that a config names."""
    accumulators: dict[str, Accumulator] = {
        "none": StateOnly(),
        "frame": FrameRadiance(),
        "temporal": TemporalRadiance(config.antilag),
        "rule": RuleRadiance(config.antilag, config.kernel_taps),
    }
    history = RadianceHistory if config.accumulates else FeatureHistory
    return Ours(
        config=config,
        traits=traits,
        networks=networks,
        sampler=None if config.ignore_density else networks.sampler,
        history=history(config.history_mode, history_features(config), config.bptt),
        accumulator=accumulators[config.accumulation],
    )


def build(variant: str, device: torch.device, weights: str | None) -> Ours:
    """The method `ours` or `ours/VARIANT`.

    `weights` is None for shipped ones, the path of a file, or "random".
    """
    return build_config(VARIANTS[variant], FAMILY, variant, device, weights)


def build_config(
    config: Config, family: Family, variant: str, device: torch.device, weights: str | None
) -> Ours:
    """The method with the parts and networks of a config, as a variant of a family."""
    declared = family.variants[variant]
    networks = Networks(config)
    if not declared.learned:
        initialize(networks, config, seed=0)
        weights = "random"  # loads none
    elif weights == "random":
        kaiming_init(networks)
    load_for_inference(networks, weights, CARDS / family.weights_file(variant), device)
    return assemble(config, declared.traits, networks)
