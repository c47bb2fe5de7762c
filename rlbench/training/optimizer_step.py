"""What follows a backward pass: gradients are clipped, weights move, and their average follows.

Nothing here asks the device for a value, so that a whole step can be recorded as one launch
(rlbench.training.recorded_steps). Losses and faults lie on the device until they are read.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rlbench.training.task import TrainingConfig, TrainingError, TrainingTask

MAX_LAYERS_SHOWN = 3  # in an error message


class NonFiniteStepError(TrainingError):
    """A step that was not taken, because it would have made the weights non-finite."""

    def __init__(self, quantity: str, value: float, step: int, layers: Sequence[str]) -> None:
        """`quantity` is the loss or a gradient norm; `step` counts from 0 over the training.

        `layers` are the parameters whose values or gradients are not finite.
        """
        message = f"{quantity} is {value} at step {step} of the training"
        if layers:
            hidden = len(layers) - MAX_LAYERS_SHOWN
            more = f" and {hidden} more" if hidden > 0 else ""
            message += f", not finite in {', '.join(layers[:MAX_LAYERS_SHOWN])}{more}"
        super().__init__(message)
        self.step, self.layers = step, layers


class Anchors(NamedTuple):
    """Weights that stay near their start."""

    group: int  # number in the optimizer's `param_groups`, which give the learning rate
    weights: list[Tensor]
    starts: tuple[Tensor, ...]
    masks: tuple[Tensor, ...]  # 0 for values that start at exactly 0, which are free; else 1


class OptimizerStep:
    """Adam (Kingma and Ba 2015) with clipped gradients, and a moving average of the weights.

    Gradients of the networks and of the auxiliary network are clipped apart, each to the norm
    `config.max_grad_norm`. A step whose loss or gradients are not finite changes nothing, and no
    step after it does, until `read_loss` raises the error.

    With `config.anchor` a > 0, pretrained weights are pulled towards their start w0 by the penalty
    a / 2 |w - w0|^2 (L2-SP: Li, Grandvalet, Davoine 2018, Explicit Inductive Bias for Transfer
    Learning with Convolutional Networks). It acts beside Adam, as in AdamW, because Adam would undo
    its scale, and by its proximal step, w <- w0 + (w - w0) / (1 + rate * a), which is stable for
    any a: as a step of Adam is about as long as its rate, a weight moves no further than about
    1 / a. Weights that start at exactly 0, such as those of new channels, are free.

    In step n, from 1, the average has decay min(`config.ema_decay`, n / (n + 9)), as TensorFlow's
    moving average with `num_updates` n - 1. Buffers of integers, such as counters of batch norm,
    are copied.
    """

    def __init__(self, task: TrainingTask, config: TrainingConfig, device: torch.device) -> None:
        """Begin with the weights in `task.networks`, which count as the first average.

        Raises TrainingError for an anchor where no weight was trained before.
        """
        self.average = copy.deepcopy(task.networks)
        self._config, self._max_lr = config, task.max_lr
        pairs = list(zip(_tensors(self.average), _tensors(task.networks), strict=True))
        self._floats = [pair for pair in pairs if pair[0].is_floating_point()]
        self._counters = [pair for pair in pairs if not pair[0].is_floating_point()]
        modules = {"the networks": task.networks}
        if task.auxiliary_network is not None:
            modules["the auxiliary network"] = task.auxiliary_network
        self._weights = [list(module.parameters()) for module in modules.values()]
        self._layers = [pair for module in modules.values() for pair in module.named_parameters()]
        norms = [f"gradient norm of {name}" for name in modules]
        self._names = ["loss", *norms, *(name for name, _ in self._layers)]  # of `_values`
        groups = _parameter_groups(task, device)
        on_gpu = device.type == "cuda"
        self.optimizer = torch.optim.Adam(groups, fused=True, capturable=on_gpu)
        scalar = torch.zeros((), device=device)
        self._taken = scalar.double()  # steps, exact beyond 2^24
        self._failed = scalar.clone()  # 1 from a fault on
        vars(self.optimizer)["found_inf"] = self._failed  # Adam takes no step where it is 1
        self._loss_sum = scalar.clone()  # since the last reading
        self._values = torch.zeros(len(self._names), device=device)  # latest, or of the fault
        self._anchors = _find_anchors(task, self.optimizer) if config.anchor else []

    def set_rate(self, factor: float) -> None:
        """Set the learning rate relative to its peak."""
        for group in self.optimizer.param_groups:
            group["lr"].fill_(self._max_lr * group["lr_multiplier"] * factor)

    def resume(self, moments: Mapping[int, Mapping[str, Tensor]], steps: int) -> None:
        """Continue with the moments of each weight after this many steps."""
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": moments, "param_groups": groups})
        for weight, state in self.optimizer.state.items():
            for name in ("exp_avg", "exp_avg_sq"):  # Adam pairs values by address, not by index
                state[name] = torch.empty_like(weight).copy_(state[name])
        self._taken.fill_(steps)

    def take(self, loss: Float[Tensor, ""]) -> None:
        """Move the weights by their gradients, which belong to this loss."""
        self._clip_gradients(loss)
        self._move_weights()
        self._update_average()

    def read_loss(self, steps: int) -> float:
        """Mean loss of the last `steps` steps: all since the last reading, with one look at all.

        Raises NonFiniteStepError if one of them was not taken.
        """
        status = torch.stack([self._failed.double(), self._taken, self._loss_sum.double()])
        failed, taken, loss, *values = torch.cat([status, self._values.double()]).tolist()
        self._loss_sum.zero_()
        if not failed:
            return float(loss / steps)
        named = zip(self._names, values, strict=True)
        name, value = next(pair for pair in named if not math.isfinite(pair[1]))
        norms = values[-len(self._layers) :]
        layers = [
            layer
            for (layer, weight), norm in zip(self._layers, norms, strict=True)
            if not math.isfinite(norm) or not bool(weight.isfinite().all())
        ]
        raise NonFiniteStepError(name, value, int(taken), layers)

    def _clip_gradients(self, loss: Tensor) -> None:
        """Scale long gradients down; remember the values, unless those of a fault are there."""
        layers = [_measure_gradients(weights, loss) for weights in self._weights]
        norms = [torch.linalg.vector_norm(each) for each in layers]
        values = torch.cat([torch.stack([loss.float(), *norms]), *layers])
        self._values.copy_(self._values.where(self._failed > 0, values))
        is_fault = values.isfinite().all().logical_not()
        self._failed.copy_(torch.maximum(self._failed, is_fault.to(self._failed.dtype)))
        self._loss_sum.add_(loss)
        self._taken.add_(1 - self._failed)
        for weights, norm in zip(self._weights, norms, strict=True):
            nn.utils.clip_grads_with_norm_(weights, self._config.max_grad_norm, norm)

    @torch.no_grad()
    def _move_weights(self) -> None:
        self.optimizer.step()
        for number, weights, starts, masks in self._anchors:
            rate = self.optimizer.param_groups[number]["lr"]
            share = (1 - 1 / (1 + rate * self._config.anchor)) * (1 - self._failed)
            back = torch._foreach_sub(starts, weights)
            torch._foreach_mul_(back, masks)
            torch._foreach_mul_(back, share)
            torch._foreach_add_(weights, back)

    @torch.no_grad()
    def _update_average(self) -> None:
        decay = (self._taken / (self._taken + 9)).clamp(max=self._config.ema_decay)
        share = (1 - decay).to(self._failed.dtype) * (1 - self._failed)
        averages, currents = zip(*self._floats, strict=True)
        follow = torch._foreach_sub(currents, averages)
        torch._foreach_mul_(follow, share)
        torch._foreach_add_(averages, follow)
        for average, current in self._counters:
            average.copy_(current)


def _measure_gradients(weights: Sequence[nn.Parameter], loss: Tensor) -> Float[Tensor, " weights"]:
    """The norm of each weight's gradient; 0 without one."""
    gradients = [w.grad for w in weights if w.grad is not None]
    norms = iter(torch._foreach_norm(gradients) if gradients else ())
    zero = torch.zeros((), device=loss.device)
    return torch.stack([zero if w.grad is None else next(norms) for w in weights])


def _tensors(module: nn.Module) -> Iterator[Tensor]:
    return itertools.chain(module.parameters(), module.buffers())


def _parameter_groups(task: TrainingTask, device: torch.device) -> list[dict[str, Any]]:
    """The parameters that share a learning rate: of each child network, and those in no child."""
    groups = [(list(child.parameters()), name) for name, child in task.networks.named_children()]
    groups.append((list(task.networks.parameters(recurse=False)), ""))
    if task.auxiliary_network is not None:
        groups.append((list(task.auxiliary_network.parameters()), "auxiliary_network"))
    return [
        {
            "params": parameters,
            "lr": torch.tensor(task.max_lr, device=device),
            "lr_multiplier": task.lr_multipliers.get(name, 1.0),
        }
        for parameters, name in groups
        if parameters
    ]


def _find_anchors(task: TrainingTask, optimizer: torch.optim.Optimizer) -> list[Anchors]:
    """The weights of each group of the optimizer that others trained before."""
    first, anchors = _first_values(task), []
    for number, group in enumerate(optimizer.param_groups):
        if weights := [weight for weight in group["params"] if weight in first]:
            starts, masks = zip(*(first[weight] for weight in weights), strict=True)
            anchors.append(Anchors(number, weights, starts, masks))
    return anchors


def _first_values(task: TrainingTask) -> dict[nn.Parameter, tuple[Tensor, Tensor]]:
    """Of each weight that was trained before a copy, and 1 where it is not 0."""
    first = {
        weight: (weight.detach().clone(), (weight.detach() != 0).to(weight.dtype))
        for name, weight in task.networks.named_parameters()
        if name.startswith(task.pretrained)
    }
    if not first:
        raise TrainingError(
            "--anchor keeps weights near those that training starts from, and all of these are "
            "random. Name weights with --start, or omit --anchor"
        )
    return first
