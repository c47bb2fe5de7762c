"""Networks that learn, their average and their optimiser: one sequence after another."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from rlbench.frames import Clip
from rlbench.training import checkpoint
from rlbench.training.task import TrainingError, TrainingTask


class NonFiniteStep(NamedTuple):
    """What went out of bounds, and where."""

    what: str  # the loss, or the length of a network's gradient
    value: float
    step: int  # of this sequence, from 0
    layers: tuple[str, ...]  # whose weights or gradients are not finite

    def __str__(self) -> str:
        """In words."""
        more = f" and {len(self.layers) - 3} more" if len(self.layers) > 3 else ""
        layers = f", not finite in {', '.join(self.layers[:3])}{more}" if self.layers else ""
        return f"{self.what} is {self.value} at step {self.step} of the sequence{layers}"


class NotFiniteError(TrainingError):
    """A step that was not made, since it would have ruined the weights."""

    def __init__(self, found: NonFiniteStep) -> None:
        """With what was found."""
        super().__init__(str(found))
        self.found = found


class TrainState:
    """What is trained, with Adam (Kingma and Ba 2015) and an exponential average of the weights.

    `before` holds the tensors that a sequence began with, so that one that failed can be replayed.
    """

    def __init__(
        self, trainer: TrainingTask, norm: float, average: float, half: bool, device: str
    ) -> None:
        """Begin with the trainer's weights."""
        self.trainer, self.norm, self.keep, self.half = trainer, norm, average, half
        self.device = torch.device(device)
        self.steps = 0
        self.networks = trainer.networks
        self.networks.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = copy.deepcopy(self.networks)
        self.optimizer = torch.optim.Adam(_groups(trainer), trainer.max_lr)
        self.before: dict[str, Tensor] = {}
        self._pairs = _pairs(self.average, self.networks)
        self._learning = [("the networks", self.networks)]  # their gradients are clipped apart
        if trainer.aside is not None:
            self._learning.append(("aside", trainer.aside))

    def sequence(self, clip: Clip, spp: float, rate: float, done: float) -> float:
        """Take a step for every loss of one clip; returns the mean loss.

        `rate` is the learning rate as a share of the peak, `done` the share of the training that
        is over. Raises NotFiniteError before a step that would not be finite.
        """
        self._remember()
        for _, module in self._learning:
            module.train()
        for group in self.optimizer.param_groups:
            group["lr"] = self.trainer.max_lr * group["share"] * rate
        self.trainer.on_progress(done)
        losses = self.trainer.losses(clip, spp)
        total, count = 0.0, 0
        while (loss := self._forward(losses)) is not None:
            self._check("loss", loss, count)
            self._backward(loss)
            self._clip(count)
            self._step()
            self._update_ema()
            total, count = total + loss.item(), count + 1
        return total / max(count, 1)

    def _remember(self) -> None:
        packed = checkpoint.state_tensors(self.networks, self.optimizer, self.trainer.aside)
        self.before = {name: tensor.detach().clone() for name, tensor in packed.items()}

    def _forward(self, losses: Iterator[Tensor]) -> Tensor | None:
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.half):
            return next(losses, None)

    def _backward(self, loss: Tensor) -> None:
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]

    def _clip(self, step: int) -> None:
        for name, module in self._learning:
            gradients = [weight.grad for weight in module.parameters() if weight.grad is not None]
            length = nn.utils.get_total_norm(gradients)
            self._check(f"length of the gradient of {name}", length, step)  # before it spreads
            nn.utils.clip_grads_with_norm_(module.parameters(), self.norm, length)

    def _step(self) -> None:
        self.optimizer.step()

    @torch.no_grad()
    def _update_ema(self) -> None:
        """Move the average towards the weights, faster at the start; counters are copied."""
        keep = min(self.keep, (1 + self.steps) / (10 + self.steps))
        slow, fast, counters = self._pairs
        torch._foreach_lerp_(slow, fast, 1 - keep)
        for mine, theirs in counters:
            mine.copy_(theirs)
        self.steps += 1

    def _check(self, what: str, value: Tensor, step: int) -> None:
        if torch.isfinite(value):
            return
        wrong = [
            name
            for _, module in self._learning
            for name, weight in module.named_parameters()
            if not all(bool(t.isfinite().all()) for t in (weight, weight.grad) if t is not None)
        ]
        raise NotFiniteError(NonFiniteStep(what, value.item(), step, tuple(wrong)))


def _groups(trainer: TrainingTask) -> list[dict[str, Any]]:
    """The parameters of each child network, of none, and aside; each with its learning rate."""
    children = trainer.networks.named_children()
    pairs = [(list(child.parameters()), name) for name, child in children]
    pairs.append((list(trainer.networks.parameters(recurse=False)), ""))
    pairs.append((list(trainer.aside.parameters()) if trainer.aside else [], "aside"))
    shares = trainer.lr_multipliers
    return [{"params": own, "share": shares.get(name, 1.0)} for own, name in pairs if own]


def _pairs(
    average: nn.Module, networks: nn.Module
) -> tuple[list[Tensor], list[Tensor], list[tuple[Tensor, Tensor]]]:
    """Tensors to average, those that they follow, and pairs of such as cannot be averaged."""
    both = list(zip(average.state_dict().values(), networks.state_dict().values(), strict=True))
    moving = [pair for pair in both if pair[0].is_floating_point()]
    counters = [pair for pair in both if not pair[0].is_floating_point()]
    return [slow for slow, _ in moving], [fast for _, fast in moving], counters
