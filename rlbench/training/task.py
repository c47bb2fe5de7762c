"""How to make a method trainable (its `TrainingTask`), and how to train it (`TrainingConfig`).

Write a function that takes the variant's name, a device and a seed, and returns a `TrainingTask`.
Name the function in the family: `Family(..., train="my_method.train:training_task")`. Then
`rlbench train --methods my_method` trains the method with the loop, crops, schedule and number of
frames that all other methods get.

A method with one convolution, and its training task:

>>> from dataclasses import dataclass
>>> import torch
>>> from rlbench.family import Traits
>>> from rlbench.ops.init import kaiming_init
>>> from rlbench.run import unroll
>>> from rlbench.training import BUDGETS_FROM_1_SPP, TrainingTask
>>> @dataclass(frozen=True)
... class Blur:
...     network: torch.nn.Module
...     traits: Traits = Traits()
...
...     def start(self, size):
...         return None
...
...     def plan(self, gbuffer, samples, state):
...         return torch.ones_like(samples.mean[:, :1])
...
...     def denoise(self, gbuffer, samples, state):
...         return self.network(samples.mean), None
>>> def training_task(variant, device, seed):
...     method = Blur(torch.nn.Conv2d(3, 3, 5, padding=2))
...     kaiming_init(method.network, seed)
...     method.network.to(device)
...
...     def losses(clip, spp):
...         for result in unroll(method, clip, spp):
...             yield (result.image - result.frame.reference.mean).abs().mean()
...
...     return TrainingTask(method, method.network, losses, BUDGETS_FROM_1_SPP)
>>> task = training_task("", torch.device("cpu"), seed=0)
>>> task.max_lr
0.0005

Rules for `losses`:

- It is a generator. The loop takes one optimiser step for each loss that it yields, and only then
  asks for the next one. Detach the state that is carried over a `yield`, or yield one loss for all
  frames.
- Everything that changes during training must be in `networks` or `auxiliary_network`, because a
  checkpoint contains only these, the optimiser's moments and the progress. Seed random numbers from
  the clip (`frame.pool.rounding_seeds`), so that a resumed run repeats them.
- A sampler that learns by gradient wraps the method in `SurrogateGradient`; see
  `baselines/ntas/train.py`. A sampler that learns from rewards: see `methods/ours/train.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from rlbench.errors import RlbenchError

if TYPE_CHECKING:
    from torch import Tensor, nn

    from rlbench.frames import Clip
    from rlbench.method import Method

# training budgets in samples per pixel, for methods that need a sample in every pixel; repeated
# values are drawn more often
BUDGETS_FROM_1_SPP = (1.0, 1.0, 2.0, 2.0, 4.0, 4.0, 6.0)
BUDGETS_FROM_0_05_SPP = (0.05, 0.25, 0.5, *BUDGETS_FROM_1_SPP)  # for methods that need none

WARM_UP_FRACTION = 0.15  # of the frames, in which the learning rate rises
START_FACTOR, END_FACTOR = 1 / 25, 1e-4  # first and last learning rate, relative to the peak

# fields that are stored only where they are chosen
OPTIONAL = ("spp", "mix", "keep", "anchor", "anneal", "until_flat", "most_frames")


class TrainingError(RlbenchError, RuntimeError):
    """A training run that cannot start, resume or continue."""


@dataclass(frozen=True)
class TrainingTask:
    """What the training loop needs from a learned method; see the module's guide.

    The function that a family names as `train` returns it. One Adam optimiser (Kingma and Ba 2015)
    trains `networks` and `auxiliary_network`; the gradient norm is clipped for each of the two
    separately. `auxiliary_network` is a network needed only during training, such as a critic:
    checkpoints contain it, weights files do not.
    """

    method: Method  # unrolled with gradients
    networks: nn.Module  # trained, averaged and saved
    losses: Callable[[Clip, float], Iterator[Tensor]]  # (clip, spp) -> one scalar per step
    spp: tuple[float, ...]  # training budgets, samples per pixel; one is drawn for each sequence
    max_lr: float = 5e-4  # peak of Adam's learning rate
    # factors on the learning rate, by name of a child of `networks` or "auxiliary_network"
    lr_multipliers: Mapping[str, float] = field(default_factory=dict)
    # called before each sequence with the fraction of frames trained on, in [0, 1)
    on_progress: Callable[[float], None] = lambda fraction_done: None
    # called before each sequence with its clip, outside of what is recorded: for seeds and counters
    on_sequence: Callable[[Clip], None] = lambda clip: None
    origin: str = ""  # source of the initial weights, for the model card; empty if random
    # beginnings of the names of weights in `networks` that others trained before; "" is all of them
    pretrained: tuple[str, ...] = ()
    auxiliary_network: nn.Module | None = None
    frames_before: int = 0  # that the initial weights were trained on, over all starts
    eager_reason: str = ""  # why its steps cannot be recorded: what asks the device; else empty


@dataclass(frozen=True)
class TrainingConfig:
    """How a method is trained; use the same values for all methods that are compared."""

    frames: int = 12_000  # crops to train on; each frame of each clip in a batch counts
    batch: int = 1  # clips in a batch; on few frames, more steps are worth more
    crop: int = 128  # side of a crop, pixels
    sequence_length: int = 6  # frames
    ema_decay: float = 0.998  # of the averaged weights, which are validated and saved
    seed: int = 0
    max_grad_norm: float = 1.0  # longer gradients are scaled down to this L2 norm
    bf16: bool = False  # bfloat16 autocast of the forward pass
    eval_interval: int = 1_000  # frames between validations, and between checkpoints
    spp: tuple[float, ...] = ()  # training budgets; empty for those of the method's TrainingTask
    mix: float = 0.0  # share of crops from clips that are mixed in; 0 without such clips
    # weights that are saved: the last average, or that of the best validation by the mean over
    # the validation sets ("best") or by one of them ("best:NAME")
    keep: str = "last"
    # pull towards the first values of weights that others trained before (L2-SP); 0: none
    anchor: float = 0.0
    # minutes of training in which the learning rate rises and falls, in place of `frames`; 0: none
    anneal: float = 0.0
    # train in cycles, the first of `frames`, each later one as long as all before it, until one
    # gains less than this on the mean over the validation sets, in dB; 0: one cycle
    until_flat: float = 0.0
    most_frames: int = 2_000_000  # after which no further cycle begins

    def __post_init__(self) -> None:
        """Raise TrainingError if the length of the training is given twice."""
        if self.anneal and self.until_flat:
            raise TrainingError(
                f"--anneal {self.anneal:g} ends a training after minutes, and --until-flat "
                f"{self.until_flat:g} where it gains no more. Give one of them"
            )

    def to_dict(self) -> dict[str, Any]:
        """The config as it is stored in JSON, with `OPTIONAL` fields only where they are chosen."""
        stored = asdict(self) | {"spp": list(self.spp)}
        return {
            name: value
            for name, value in stored.items()
            if name not in OPTIONAL or getattr(self, name) != getattr(TrainingConfig, name)
        }

    @property
    def keeps_best(self) -> bool:
        """True if the weights of the best validation are saved, instead of the last ones."""
        return self.keep != "last"

    def lr_factor(self, fraction_done: float) -> float:
        """One-cycle learning rate, relative to the peak for one crop at a time; above 0.

        It rises by a half cosine, then falls by one (Smith and Topin 2018), as in torch's
        OneCycleLR with pct_start 0.15, div_factor 25, final_div_factor 400 (1e4 / 25). Kept as a
        pure function, because OneCycleLR has a state that a checkpoint would have to contain, and
        counts steps, whose number is not known in advance; a test compares the two. It grows with
        the square root of the batch, as the noise of Adam's steps falls (Malladi et al. 2022, On
        the SDEs and Scaling Rules for Adaptive Gradient Algorithms).

        >>> [TrainingConfig().lr_factor(fraction) for fraction in (0, 0.15, 1)]
        [0.04, 1.0, 0.0001]
        >>> TrainingConfig(batch=4).lr_factor(0.15)
        2.0
        """
        if fraction_done < WARM_UP_FRACTION:
            low, position = START_FACTOR, fraction_done / WARM_UP_FRACTION
        else:
            low = END_FACTOR
            position = 1 - (fraction_done - WARM_UP_FRACTION) / (1 - WARM_UP_FRACTION)
        factor = low + (1.0 - low) * (1 - math.cos(math.pi * position)) / 2
        return factor * math.sqrt(self.batch)
