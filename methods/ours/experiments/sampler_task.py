"""What a training of the sampler alone starts from: clips, frozen networks, a new sampler."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import torch

from methods.ours import FAMILY
from methods.ours.environment import SamplingEnv
from methods.ours.initialization import wire_contrast
from methods.ours.method import CARDS, Ours, assemble
from methods.ours.networks import Networks, Sampler
from methods.ours.variants import VARIANTS, Config
from rlbench.ops.init import kaiming_init
from rlbench.training.batches import Batches
from rlbench.training.task import BUDGETS_FROM_0_05_SPP
from rlbench.weights import load_for_inference

__all__ = ["SamplerTask"]


@dataclass(frozen=True)
class SamplerTask:
    """The clips and weights of one training. It makes the same environment in any process."""

    folders: tuple[Path, ...]  # clips
    weights: Path = CARDS / "ours.safetensors"  # of encoder and denoiser
    variant: str = ""  # whose weights these are: "" or "paper"
    one_policy: bool = False  # RLlib's APPO as in the paper: one ratio and reward a frame
    crop: int = 128  # pixels, side of a crop
    length: int = 6  # frames of an episode
    seed: int = 0
    min_samples: int = 0  # of each pixel

    @property
    def config(self) -> Config:
        """The settings of the variant."""
        return VARIANTS[self.variant]

    @property
    def scored_as(self) -> str:
        """The method that the weights belong to: A1 gives every pixel a sample."""
        names = [self.variant, "A1" * bool(self.min_samples)]
        key = "-".join(filter(None, names))
        return f"ours/{key}" if key else "ours"

    def make_method(self) -> Ours:
        """The method during training: an untrained sampler, and the other networks frozen."""
        networks = Networks(self.config)
        load_for_inference(networks, str(self.weights), self.weights, "cpu")
        sampler = self.make_sampler()
        networks.sampler = sampler.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        traits = replace(FAMILY.variants[self.variant].traits, min_samples=self.min_samples)
        return assemble(self.config.for_training, traits, networks)

    def make_sampler(self) -> Sampler:
        """A sampler with the first weights of every training: seeded, and its actions 0."""
        config = self.config
        sampler = Networks(config).sampler
        assert sampler is not None
        kaiming_init(sampler, self.seed)
        if config.wired_contrast:
            wire_contrast(sampler, config)
        sampler.start_uniform()
        return sampler

    def make_batches(self) -> Batches:
        """Crops of the clips, one at a time."""
        return Batches(self.folders, 1, self.crop, self.length, self.seed)

    def make_env(self) -> SamplingEnv:
        """Episodes of crops, at the budgets that `ours` is trained at."""
        budgets = [spp for spp in BUDGETS_FROM_0_05_SPP if spp >= self.min_samples]
        return SamplingEnv(self.make_method(), self.make_batches(), budgets)
