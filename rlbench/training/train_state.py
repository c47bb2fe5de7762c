"""The state of a training run: networks, average and optimizer; its steps and its validation."""

from __future__ import annotations

import copy
import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.ops.recording import Recorder
from rlbench.run import run_clip
from rlbench.training.checkpoint import select_prefix
from rlbench.training.optimizer_step import OptimizerStep
from rlbench.training.recorded_steps import RecordedSteps, Steps
from rlbench.training.task import TrainingConfig, TrainingTask

_logger = logging.getLogger(__name__)

DEFAULT_BUDGETS = (1.0, 4.0)  # of a validation, samples per pixel
READING_INTERVAL = 100  # recorded steps between two readings of the loss


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


class TrainState:
    """The networks of a training task, the steps that train them, and their averaged weights."""

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
        torch.backends.cudnn.benchmark = True  # crops have one size
        self.step = OptimizerStep(task, config, self.device)
        self.steps = 0  # taken since the start of the run
        self.best: dict[str, Tensor] = {}  # averaged weights that `keep_average` stored
        self._run_steps: Steps = self._run_plain_steps
        self._unread, self._loss, self._reading_interval = 0, 0.0, 1
        if recorder and task.eager_reason:
            _logger.warning("steps are not recorded: %s", task.eager_reason)
        elif recorder:
            groups = self.step.optimizer.param_groups
            weights = [each for group in groups for each in group["params"]]
            self._run_steps = RecordedSteps(self._run_plain_steps, weights, recorder)
            self._reading_interval = READING_INTERVAL

    @property
    def average(self) -> nn.Module:
        """The networks with averaged weights, which are validated and saved."""
        return self.step.average

    def train_sequence(
        self, clip: Clip, spp: float, lr_factor: float, fraction_done: float
    ) -> float:
        """Take one step for each loss of a clip; returns the mean loss of those read last.

        These are all steps of this clip, or, if steps are recorded, those up to the last multiple
        of a hundred. `lr_factor` is the learning rate relative to the peak, `fraction_done` the
        fraction of the run's frames already seen. Raises NonFiniteStepError as `read_loss` does.
        """
        for module in filter(None, (self.networks, self.task.auxiliary_network)):
            module.train()
        self.step.set_rate(lr_factor)
        self.task.on_progress(fraction_done)
        self.task.on_sequence(clip)
        for _ in self._run_steps(clip, spp):
            self.steps, self._unread = self.steps + 1, self._unread + 1
        return self.read_loss() if self._unread >= self._reading_interval else self._loss

    def read_loss(self) -> float:
        """The mean loss of the steps since the last reading, or the last mean if there were none.

        Raises NonFiniteStepError if one of them was not finite: it, and those after it, changed no
        weight.
        """
        if self._unread:
            self._loss, self._unread = self.step.read_loss(self._unread), 0
        return self._loss

    def validate(self, sets: Mapping[str, Sequence[Path]]) -> ValidationResult:
        """Score the averaged weights, see `validate`, at the `validation_budgets`.

        The networks get their own weights back, and are left in evaluation mode. Raises
        NonFiniteStepError as `read_loss` does.
        """
        self.read_loss()
        trained = copy.deepcopy(self.networks.state_dict())
        self.networks.load_state_dict(self.average.state_dict())
        self.networks.eval()
        spp = validation_budgets(self.task.method, self.task.spp, self.config.spp)
        result = validate(self.task.method, sets, spp, str(self.device))
        self.networks.load_state_dict(trained)
        return result

    def state_dict(self) -> dict[str, Tensor]:
        """All tensors of the run by name, for a checkpoint; they are not copied.

        Raises NonFiniteStepError as `read_loss` does.
        """
        self.read_loss()
        tensors = {f"weights.{k}": v for k, v in self.networks.state_dict().items()}
        if (auxiliary := self.task.auxiliary_network) is not None:
            tensors |= {f"auxiliary_network.{k}": v for k, v in auxiliary.state_dict().items()}
        for index, moments in self.step.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{index}.{k}": v for k, v in moments.items()}
        tensors |= {f"ema.{name}": tensor for name, tensor in self.average.state_dict().items()}
        return tensors | {f"best.{name}": tensor for name, tensor in self.best.items()}

    def keep_average(self) -> None:
        """Store a copy of the averaged weights as the best ones, in half floats as they ship."""
        self.best = {
            name: tensor.half() if tensor.is_floating_point() else tensor.clone()
            for name, tensor in self.average.state_dict().items()
        }

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
        self.step.resume(moments, steps)
        self.average.load_state_dict(select_prefix("ema.", tensors))
        self.steps = steps
        self.best = select_prefix("best.", tensors)

    def _forward(self, losses: Iterator[Tensor]) -> Tensor | None:
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.bf16):
            return next(losses, None)

    def _run_plain_steps(self, clip: Clip, spp: float) -> Iterator[Tensor]:
        """A step for each loss of a clip."""
        losses = self.task.losses(clip, spp)
        while (loss := self._forward(losses)) is not None:
            self._backward(loss)
            self.step.take(loss.detach())
            yield loss.detach()

    def _backward(self, loss: Tensor) -> None:
        self.step.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]


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
