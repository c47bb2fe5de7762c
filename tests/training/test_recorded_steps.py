"""Recorded steps train as plain ones do; tasks that cannot be recorded say why."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest
import torch
from torch import nn

from rlbench import registry
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.training import TrainingConfig, TrainingError, TrainingTask
from rlbench.training.loop import train
from rlbench.training.optimizer_step import NonFiniteStepError
from rlbench.training.train_state import TrainState
from tests.tapes import Tapes

ROWS = ("oidn/retrained", "accumulate/tuned", "ours/A2", "nppd", "imcd", "ntas", "dasr")
LEARNERS = ("ours", "ours/A1", "ours/paper-appo")  # of samplers


def sequence(seed: int) -> InMemoryClip:
    return procedural_clip(seed, Size(1, 32, 32), frames=2)


def parameters(network: nn.Module) -> torch.Tensor:
    return torch.cat([each.detach().clone().flatten() for each in network.parameters()])


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[pytest.mark.slow] * (n in ("nppd", "imcd")))
        for n in (*ROWS, *LEARNERS)
    ],
)
def test_recorded_steps_train_as_plain_ones_do(name):
    """Two budgets, each recorded once; weights differ by the rounding of forms that ask nothing."""
    states, losses, recorder = [], [], Tapes()
    for each in (None, recorder):
        state = TrainState(registry.training_task(name, "cpu"), TrainingConfig(), "cpu", each)
        for seed, spp in enumerate((1.0, 2.0, 1.0, 2.0, 1.0)):
            state.train_sequence(sequence(seed), spp, 1.0, 0.9)
            losses.append(state.read_loss())
        states.append(state.state_dict())  # networks, average, moments
    plain, recorded = states
    # a count that is rounded the other way changes an image; losses in logarithms are near zero
    assert losses[5:] == pytest.approx(losses[:5], rel=2e-3, abs=2e-3)
    for key, tensor in plain.items():  # Adam takes a whole step where a gradient is rounding
        torch.testing.assert_close(recorded[key], tensor, rtol=1e-3, atol=1e-3)
    assert {tape.replays for tape in recorder.tapes if tape.replays} == {1, 2}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["oidn/retrained", "accumulate/tuned", "ours/A2"])
def test_after_fifty_steps_recorded_weights_differ_by_a_hundredth_of_their_way(name):
    first = parameters(registry.training_task(name, "cpu").networks)
    after = []
    for each in (None, Tapes()):
        state = TrainState(registry.training_task(name, "cpu"), TrainingConfig(), "cpu", each)
        for seed in range(25):  # of two frames
            state.train_sequence(sequence(seed), 1.0 + seed % 2, 1.0, 0.9)
        assert state.steps == 50
        after.append(parameters(state.networks))
    plain, recorded = after
    assert (recorded - plain).norm() < 0.01 * (plain - first).norm()


def test_a_fault_in_a_recorded_step_is_found_later_and_changes_no_weight():
    network = nn.Conv2d(3, 3, 1)
    task = TrainingTask(
        registry.load_method("mean"),
        network,
        lambda clip, spp: (network(frame.pool.radiance[0]).square().mean() for frame in clip),
        (1.0,),
        max_lr=1e-2,
    )
    state = TrainState(task, TrainingConfig(), "cpu", Tapes())
    dark = replace(sequence(0), frames=list(sequence(0)))
    for frame in dark:
        frame.pool.radiance.fill_(math.nan)
    for clip in (sequence(0), sequence(0)):
        state.train_sequence(clip, 1.0, 1.0, 0.0)
    tensors = [*state.networks.parameters(), *state.average.parameters()]
    tensors += [
        each for of_weight in state.step.optimizer.state.values() for each in of_weight.values()
    ]
    before = [each.clone() for each in tensors]
    for clip in (dark, sequence(0)):
        state.train_sequence(clip, 1.0, 1.0, 0.0)
    with pytest.raises(NonFiniteStepError, match="loss is nan at step 4 of the training") as raised:
        state.read_loss()
    assert raised.value.layers == ["weight", "bias"]
    torch.testing.assert_close(tensors, before, rtol=0, atol=0)


class Refusing(Tapes):
    """A recorder that can record nothing."""

    def record(self, function):
        raise RuntimeError("operation not permitted when stream is capturing")


def test_steps_that_cannot_be_recorded_run_as_they_are_and_say_why(caplog):
    losses = []
    for recorder in (None, Refusing()):
        task = registry.training_task("oidn/retrained", "cpu")
        state = TrainState(task, TrainingConfig(), "cpu", recorder)
        for seed in range(3):
            state.train_sequence(sequence(seed), 1.0, 1.0, 0.9)
            losses.append(state.read_loss())
    assert losses[3:] == losses[:3]
    assert len(re.findall("cannot be recorded.*stream is capturing", caplog.text)) == 1


def test_a_task_that_draws_numbers_on_the_host_says_so_and_runs_as_it_is(caplog):
    recorder = Tapes()
    state = TrainState(
        replace(
            registry.training_task("dasr", "cpu"), eager_reason="numbers are drawn by the host"
        ),
        TrainingConfig(),
        "cpu",
        recorder,
    )
    assert "drawn by" in state.task.eager_reason
    assert state.task.eager_reason in caplog.text
    state.train_sequence(sequence(0), 1.0, 1.0, 0.0)
    assert not recorder.tapes


def test_steps_are_recorded_on_a_gpu_alone(tmp_path):
    with pytest.raises(TrainingError, match="--graph records CUDA graphs, and cannot run on cpu"):
        train("oidn/tuned", [], [], tmp_path, TrainingConfig(), graph=True)
