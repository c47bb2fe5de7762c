"""One frame of the proposed method: plan from the warped state, encode what was bought, denoise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from methods.ours import FAMILY
from methods.ours.network import Networks
from methods.ours.variants import VARIANTS, Config
from rlbench.family import Traits
from rlbench.frames import Size, View
from rlbench.ops.initialise import initialise
from rlbench.ops.pad import crop, pad
from rlbench.ops.transfer import log_forward, log_inverse, squash_depth
from rlbench.ops.warp import recall
from rlbench.sampling import Samples
from rlbench.weights import equip

CARDS = Path(__file__).parent / "cards"
MISSING = -1.0  # a sample that was not bought, a state that is not there
MULTIPLE = 16  # sides that the denoiser can halve four times


class Memory(NamedTuple):
    """The latent state, and how many frames it has lived."""

    latent: Float[Tensor, "n c h w"]  # in [-1, 1]; MISSING everywhere before the first frame
    age: int


@dataclass(frozen=True)
class Ours:
    """Scardigli et al. 2023: sampler on the warped state, encoder of raw samples, denoiser.

    Differs from the paper: the density is the action above the lower end of its range (x + 1, x in
    [-1, 1]) and not above the frame's least action, which is an outlier of half a million values;
    networks see linear radiance through a logarithm where the authors' data was 8-bit sRGB; a state
    that comes from outside the image is marked by an exact mask, not by a magic zero.
    """

    config: Config
    traits: Traits
    networks: Networks

    def start(self, size: Size) -> Memory:
        """No memory: the sentinel everywhere."""
        device = next(self.networks.parameters()).device
        shape = (size.n, self.config.latent, size.h, size.w)
        return Memory(torch.full(shape, MISSING, device=device), 0)

    def plan(self, view: View, samples: Samples, state: Memory) -> Float[Tensor, "n 1 h w"]:
        """How far each pixel's action lies above the lowest one, in [0, 2]."""
        if self.networks.sampler is None or self.config.flat:
            return torch.ones_like(view.depth)
        return density(self.act(view, state))

    def act(self, view: View, state: Memory) -> Float[Tensor, "n 1 h w"]:
        """The sampler's mean action, in [-1, 1]."""
        assert self.networks.sampler is not None
        known = self._known(view, state)
        h, w = known.shape[-2:]
        action: Tensor = self.networks.sampler(pad(known, MULTIPLE))
        return crop(action, h, w).float()

    def denoise(
        self, view: View, samples: Samples, state: Memory
    ) -> tuple[Float[Tensor, "n 3 h w"], Memory]:
        """The image in linear radiance, and the encoded state."""
        seen = torch.cat((self._values(samples), self._known(view, state)), dim=1)
        h, w = seen.shape[-2:]
        latent = self.networks.encoder(pad(seen, MULTIPLE))
        value = crop(self.networks.denoiser(latent), h, w).float()
        value = value if self.networks.training else value.clamp_min(0)
        return log_inverse(value), Memory(crop(latent, h, w).float(), state.age + 1)

    def _values(self, samples: Samples) -> Float[Tensor, "n c h w"]:
        """Each sample by itself in log transfer, MISSING in slots that are empty or not stored."""
        values = log_forward(samples.radiance).where(samples.filled, MISSING)  # n s 3 h w
        short = self.config.slots - values.shape[1]
        return F.pad(values, (0,) * 7 + (short,), value=MISSING).flatten(1, 2)

    def _known(self, view: View, state: Memory) -> Float[Tensor, "n c h w"]:
        """What is known before sampling: normal, albedo, depth, and the state moved here."""
        latent = state.latent if state.age % self.config.bptt else state.latent.detach()
        history = recall(latent, view.motion, MISSING)
        return torch.cat((view.normal, view.albedo, squash_depth(view.depth), history), dim=1)


def density(action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
    """How far an action lies above the lowest one; actions beyond [-1, 1] are clamped."""
    return 1 + action.clamp(-1, 1)


def build(variant: str, device: torch.device, weights: str | None) -> Ours:
    """The method `ours` or `ours/VARIANT`, with shipped weights, a file's, or random ones."""
    config = VARIANTS[variant]
    networks = Networks(config)
    if weights == "random":
        initialise(networks)
    equip(networks, weights, CARDS / FAMILY.weights(variant), device)
    return Ours(config, FAMILY.variants[variant].traits, networks)
