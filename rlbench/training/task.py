"""How to make a method trainable: return its networks, losses and budgets as a `TrainingTask`.

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

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from torch import Tensor, nn

from rlbench.errors import RlbenchError
from rlbench.frames import Clip
from rlbench.method import Method

__all__ = ["BUDGETS_FROM_0_05_SPP", "BUDGETS_FROM_1_SPP", "TrainingError", "TrainingTask"]

# training budgets in samples per pixel, for methods that need a sample in every pixel; repeated
# values are drawn more often
BUDGETS_FROM_1_SPP = (1.0, 1.0, 2.0, 2.0, 4.0, 4.0, 6.0)
BUDGETS_FROM_0_05_SPP = (0.05, 0.25, 0.5, *BUDGETS_FROM_1_SPP)  # for methods that need none


class TrainingError(RlbenchError, RuntimeError):
    """A training run that cannot start, resume or continue."""


def ignore_progress(fraction_done: float) -> None:
    """The default `TrainingTask.on_progress`: does nothing."""


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
    max_lr: float = 5e-4  # peak of Adam's learning rate; choose it by `find_learning_rate`
    # factors on the learning rate, by name of a child of `networks` or "auxiliary_network"
    lr_multipliers: Mapping[str, float] = field(default_factory=dict)
    # called before each sequence with the fraction of frames trained on, in [0, 1)
    on_progress: Callable[[float], None] = ignore_progress
    origin: str = ""  # source of the initial weights, for the model card; empty if random
    auxiliary_network: nn.Module | None = None
