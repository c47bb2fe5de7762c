"""What a family hands over to be trained: networks, their losses, their budgets."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from torch import Tensor, nn

from rlbench.errors import RlbenchError
from rlbench.frames import Clip
from rlbench.method import Method

BUDGETS_FROM_1_SPP = (
    1.0,
    1.0,
    2.0,
    2.0,
    4.0,
    4.0,
    6.0,
)  # budgets of what needs a sample in every pixel


class TrainingError(RlbenchError, RuntimeError):
    """A training that cannot start or go on."""


@dataclass(frozen=True)
class TrainingTask:
    """What is trained: made by the function that a family's `train` names.

    All that changes while it is trained lies in `networks` and `aside`: a training that was killed
    goes on from them, the optimiser and the number of the draw alone. A loss may reach `aside`, a
    network that is needed while the others learn and no longer after, such as a critic.
    """

    method: Method  # unrolled with gradients; state must be detached where `losses` yields
    networks: nn.Module  # what is trained and saved
    losses: Callable[[Clip, float], Iterator[Tensor]]  # one optimiser step for each that it yields
    spp: tuple[float, ...]  # budgets, one drawn for each sequence
    max_lr: float = 5e-4  # highest learning rate of Adam, by a range test of this architecture
    lr_multipliers: Mapping[str, float] = field(
        default_factory=dict
    )  # of it, by child of `networks`
    on_progress: Callable[[float], None] = lambda done: (
        None
    )  # before each sequence, share of frames seen
    origin: str = ""  # of the first weights, for the card; empty for random ones
    aside: nn.Module | None = None  # trained at shares["aside"] and kept, but not shipped
