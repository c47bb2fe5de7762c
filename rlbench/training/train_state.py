"""The state of a training run: networks, average and optimiser; its steps and its validation."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.ops.recording import Recorder
from rlbench.run import run_clip
from rlbench.training.checkpoint import select_prefix
from rlbench.training.recorded_steps import Backward, RecordedSteps
from rlbench.training.task import TrainingConfig, TrainingError, TrainingTask

DEFAULT_BUDGETS = (1.0, 4.0)  # of a validation, samples per pixel
MAX_LAYERS_SHOWN = 3  # in an error message

Tensors = tuple[Tensor, ...] | list[Tensor]


class NonFiniteStepError(TrainingError):
    """A step that was not taken, because it would have made the weights non-finite."""

    def __init__(self, quantity: str, value: float, step: int, layers: Sequence[str]) -> None:
        """`quantity` is the loss or a gradient norm; `step` counts from 0 within the sequence.

        `layers` are the parameters whose values or gradients are not finite.
        """
        message = f"{quantity} is {value} at step {step} of the sequence"
        if layers:
            hidden = len(layers) - MAX_LAYERS_SHOWN
            more = f" and {hidden} more" if hidden > 0 else ""
            message += f", not finite in {', '.join(layers[:MAX_LAYERS_SHOWN])}{more}"
        super().__init__(message)
        self.step, self.layers = step, layers


class SetScore(NamedTuple):
    """The score of one validation set, in dB."""

    psnr: float  # mean over clips, budgets and frames
    first_frames: float  # mean over clips and budgets of the first frame, which has no history
    drift: float  # mean over clips and budgets of the last quarter of a clip less the first


class ValidationResult(NamedTuple):
    """The scores of one validation, and an image to look at."""

    sets: dict[str, SetScore]  # by name of the validation set
    preview: Float[Tensor, "3 h w"] | None  # last frame of the first clip, reference on its right

    @property
    def psnr(self) -> float:
        """Mean PSNR over the validation sets, dB; 0 without any."""
        return fmean(score.psnr for score in self.sets.values()) if self.sets else 0.0


class Anchors(NamedTuple):
    """Weights that stay near their start."""

    group: int  # number in the optimiser's `param_groups`, which give the learning rate
    weights: list[Tensor]
    starts: tuple[Tensor, ...]
    masks: tuple[Tensor, ...]  # 0 for values that start at exactly 0, which are free; else 1


class TrainState:
    """The networks of a training task with their optimiser and exponential moving average (EMA).

    The optimiser is Adam (Kingma and Ba 2015). With `config.anchor` a > 0, pretrained weights are
    pulled towards their start w0 by the penalty a / 2 |w - w0|^2 (L2-SP: Li, Grandvalet, Davoine
    2018, Explicit Inductive Bias for Transfer Learning with Convolutional Networks). It acts beside
    Adam, as in AdamW, because Adam would undo its scale, and by its proximal step,
    w <- w0 + (w - w0) / (1 + rate * a), which is stable for any a: as a step of Adam is about as
    long as its rate, a weight moves no further than about 1 / a. Weights that start at exactly 0,
    such as those of new channels, are free.
    """

    def __init__(
        self,
        task: TrainingTask,
        config: TrainingConfig,
        device: str,
        recorder: Recorder | None = None,
    ) -> None:
        """Start from the weights in `task.networks`; with a recorder, steps are recorded.

        Raises TrainingError for an anchor where no weight was trained before.
        """
        self.task, self.config, self.device = task, config, torch.device(device)
        self.networks = task.networks
        self.networks.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        average = warmed_up_ema(config.ema_decay)
        self.ema = AveragedModel(self.networks, multi_avg_fn=average, use_buffers=True)
        self.ema.update_parameters(self.networks)  # the initial weights count as the first average
        torch.backends.cudnn.benchmark = True  # crops have one size
        fused = self.device.type == "cuda"
        self.optimizer = torch.optim.Adam(_parameter_groups(task), task.max_lr, fused=fused)
        self.best: dict[str, Tensor] = {}  # averaged weights that `keep_average` stored
        self._modules = {"the networks": self.networks}  # gradients are clipped for each
        if task.auxiliary_network is not None:
            self._modules["the auxiliary network"] = task.auxiliary_network
        self._anchors = self._find_anchors() if config.anchor else []
        self._losses: Backward = self._run_backward
        if recorder and not task.eager_reason:
            weights = [each for group in self.optimizer.param_groups for each in group["params"]]
            self._losses = RecordedSteps(self._run_backward, weights, recorder)

    @property
    def ema_networks(self) -> nn.Module:
        """The networks with averaged weights, which are validated and saved."""
        return self.ema.module

    @property
    def steps(self) -> int:
        """Optimiser steps taken since the start of the run."""
        return int(self.ema.n_averaged) - 1

    def train_sequence(
        self, clip: Clip, spp: float, lr_factor: float, fraction_done: float
    ) -> float:
        """Take one step for each loss of a clip; returns the mean loss.

        `lr_factor` is the learning rate relative to the peak, `fraction_done` the fraction of the
        run's frames already seen. Raises NonFiniteStepError before a step that is not finite.
        """
        for module in self._modules.values():
            module.train()
        for group in self.optimizer.param_groups:
            group["lr"] = self.task.max_lr * group["lr_multiplier"] * lr_factor
        self.task.on_progress(fraction_done)
        total, count = torch.zeros((), device=self.device), 0
        for loss in self._losses(clip, spp):
            self._clip_gradients(loss, count)
            self._step()
            self._update_ema()
            total, count = total + loss, count + 1
        return total.item() / max(count, 1)

    def validate(self, sets: Mapping[str, Sequence[Path]]) -> ValidationResult:
        """Score the averaged weights, see `validate`, at the `validation_budgets`.

        The networks get their own weights back, and are left in evaluation mode.
        """
        trained = copy.deepcopy(self.networks.state_dict())
        self.networks.load_state_dict(self.ema_networks.state_dict())
        self.networks.eval()
        spp = validation_budgets(self.task.method, self.task.spp, self.config.spp)
        result = validate(self.task.method, sets, spp, str(self.device))
        self.networks.load_state_dict(trained)
        return result

    def state_dict(self) -> dict[str, Tensor]:
        """All tensors of the run by name, for a checkpoint; they are not copied."""
        tensors = {f"weights.{k}": v for k, v in self.networks.state_dict().items()}
        if (auxiliary := self.task.auxiliary_network) is not None:
            tensors |= {f"auxiliary_network.{k}": v for k, v in auxiliary.state_dict().items()}
        for index, moments in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{index}.{k}": v for k, v in moments.items()}
        tensors |= {
            f"ema.{name}": tensor for name, tensor in self.ema_networks.state_dict().items()
        }
        return tensors | {f"best.{name}": tensor for name, tensor in self.best.items()}

    def keep_average(self) -> None:
        """Store a copy of the averaged weights as the best ones."""
        averages = self.ema_networks.state_dict()
        self.best = {name: tensor.detach().clone() for name, tensor in averages.items()}

    def load_state_dict(self, tensors: Mapping[str, Tensor], steps: int) -> None:
        """Restore the tensors of `state_dict`, saved after `steps` optimiser steps."""
        self.networks.load_state_dict(select_prefix("weights.", tensors))
        if self.task.auxiliary_network is not None:
            auxiliary = select_prefix("auxiliary_network.", tensors)
            self.task.auxiliary_network.load_state_dict(auxiliary)
        moments: dict[int, dict[str, Tensor]] = {}
        for key, value in select_prefix("optimizer.", tensors).items():
            index, name = key.split(".", 1)
            moments.setdefault(int(index), {})[name] = value
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": moments, "param_groups": groups})
        self.ema_networks.load_state_dict(select_prefix("ema.", tensors))
        self.ema.n_averaged.fill_(steps + 1)
        self.best = select_prefix("best.", tensors)

    def _forward(self, losses: Iterator[Tensor]) -> Tensor | None:
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.bf16):
            return next(losses, None)

    def _run_backward(self, clip: Clip, spp: float) -> Iterator[Tensor]:
        """Each loss of a clip, with its gradients in the weights."""
        losses = self.task.losses(clip, spp)
        while (loss := self._forward(losses)) is not None:
            self._backward(loss)
            yield loss.detach()

    def _backward(self, loss: Tensor) -> None:
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]

    def _clip_gradients(self, loss: Tensor, step: int) -> None:
        """Scale long gradients down. Raises NonFiniteStepError, after one look at all values."""
        weights = {name: list(module.parameters()) for name, module in self._modules.items()}
        norms = {
            f"gradient norm of {name}": nn.utils.get_total_norm(
                [w.grad for w in ws if w.grad is not None]
            )
            for name, ws in weights.items()
        }
        quantities = {"loss": loss, **norms}
        # the norm of no gradients lies on the CPU
        floats = [value.to(loss.device, torch.float32) for value in quantities.values()]
        values = torch.stack(floats).tolist()
        for quantity, value in zip(quantities, values, strict=True):
            if not math.isfinite(value):
                raise NonFiniteStepError(quantity, value, step, self._nonfinite_layers())
        for ws, norm in zip(weights.values(), norms.values(), strict=True):
            nn.utils.clip_grads_with_norm_(ws, self.config.max_grad_norm, norm)

    def _step(self) -> None:
        self.optimizer.step()
        for number, weights, starts, masks in self._anchors:
            rate = self.optimizer.param_groups[number]["lr"]
            with torch.no_grad():
                back = torch._foreach_sub(starts, weights)
                torch._foreach_mul_(back, masks)
                torch._foreach_add_(weights, back, alpha=1 - 1 / (1 + rate * self.config.anchor))

    def _find_anchors(self) -> list[Anchors]:
        """The weights of each group of the optimiser that others trained before."""
        first, anchors = _first_values(self.task), []
        for number, group in enumerate(self.optimizer.param_groups):
            if weights := [weight for weight in group["params"] if weight in first]:
                starts, masks = zip(*(first[weight] for weight in weights), strict=True)
                anchors.append(Anchors(number, weights, starts, masks))
        return anchors

    def _update_ema(self) -> None:
        self.ema.update_parameters(self.networks)

    def _nonfinite_layers(self) -> list[str]:
        return [
            name
            for module in self._modules.values()
            for name, weight in module.named_parameters()
            if not all(bool(t.isfinite().all()) for t in (weight, weight.grad) if t is not None)
        ]


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


def _parameter_groups(task: TrainingTask) -> list[dict[str, Any]]:
    """The parameters that share a learning rate: of each child network, and those in no child."""
    groups = [(list(child.parameters()), name) for name, child in task.networks.named_children()]
    groups.append((list(task.networks.parameters(recurse=False)), ""))
    if task.auxiliary_network is not None:
        groups.append((list(task.auxiliary_network.parameters()), "auxiliary_network"))
    return [
        {"params": parameters, "lr_multiplier": task.lr_multipliers.get(name, 1.0)}
        for parameters, name in groups
        if parameters
    ]


def warmed_up_ema(decay: float) -> Callable[[Tensors, Tensors, Tensor | int], None]:
    """An exponential moving average for `AveragedModel`, faster during the first steps.

    In step n, from 1, the decay is min(decay, n / (n + 9)), as in TensorFlow's moving average
    with `num_updates` n - 1. Integer tensors, such as the counters of batch norm, are copied.
    """

    @torch.no_grad()
    def update(average: Tensors, current: Tensors, step: Tensor | int) -> None:
        n = int(step)
        if average[0].is_floating_point():  # tensors come grouped by dtype
            torch._foreach_lerp_(average, current, 1 - min(decay, n / (n + 9)))
        else:
            torch._foreach_copy_(average, current)

    return update


def validation_budgets(
    method: Method, training_budgets: Sequence[float], requested: Sequence[float]
) -> list[float]:
    """The budgets to validate at, in samples per pixel.

    1 and 4 spp if the method supports both and no training budgets were `requested`. Otherwise the
    smallest and the largest budget that the method is trained at.
    """
    unsupported = any(method.traits.unsupported_reason(spp) for spp in DEFAULT_BUDGETS)
    if not requested and not unsupported:
        return list(DEFAULT_BUDGETS)
    return sorted({min(requested or training_budgets), max(requested or training_budgets)})


def validate(
    method: Method, sets: Mapping[str, Sequence[Path]], spp: Sequence[float], device: str
) -> ValidationResult:
    """Mean PSNR of a method on each set of clips, at each budget in `spp`.

    A clip with fewer samples than a budget is validated with all that it has.
    """
    psnr = registry.load_plugin("metrics", "psnr")
    drift = registry.load_plugin("metrics", "drift").from_psnr
    scores: dict[str, SetScore] = {}
    preview = None
    for name, folders in sets.items():
        frames, first_frames, drifts = [], [], []
        for folder in folders:
            clip = open_clip(folder, method.traits.inputs, pool=method.traits.pool, device=device)
            for budget in sorted({min(each, float(clip.max_samples)) for each in spp}):
                psnrs = []
                for result in run_clip(method, clip, budget):
                    reference = result.frame.reference
                    compared = psnr.compare(result.image, reference.half_a, reference.half_b)
                    psnrs += psnr.score(compared).tolist()
                frames += psnrs
                first_frames += psnrs[:1]
                drifts.append(drift(psnrs))
                if preview is None:
                    preview = torch.cat((result.image[0], reference.mean[0]), dim=-1)
        scores[name] = SetScore(*(fmean(each or [0.0]) for each in (frames, first_frames, drifts)))
    return ValidationResult(scores, preview)
