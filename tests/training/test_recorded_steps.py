"""Recorded steps train as plain ones do; tasks that cannot be recorded say why."""

from __future__ import annotations

import pytest
import torch

from rlbench import registry
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.training import TrainingConfig, TrainingError
from rlbench.training.loop import train
from rlbench.training.train_state import TrainState
from tests.tapes import Tapes

ROWS = ("oidn/retrained", "accumulate/tuned", "ours/A2", "nppd", "imcd", "ntas")


def sequence(seed: int) -> InMemoryClip:
    return procedural_clip(seed, Size(1, 32, 32), frames=2)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n in ("nppd", "imcd"))) for n in ROWS]
)
def test_recorded_steps_train_as_plain_ones_do(name):
    """Two budgets, each recorded once; weights differ by the rounding of forms that ask nothing."""
    states, recorder = [], Tapes()
    for each in (None, recorder):
        state = TrainState(registry.training_task(name, "cpu"), TrainingConfig(), "cpu", each)
        losses = [
            state.train_sequence(sequence(seed), spp, 1.0, seed / 5)
            for seed, spp in enumerate((1.0, 2.0, 1.0, 2.0, 1.0))
        ]
        states.append((losses, state.networks.state_dict()))
    (losses, weights), (recorded_losses, recorded_weights) = states
    assert recorded_losses == pytest.approx(losses, rel=2e-3)
    for key, weight in weights.items():
        torch.testing.assert_close(recorded_weights[key], weight, rtol=1e-3, atol=2e-4)
    assert {tape.replays for tape in recorder.tapes if tape.replays} == {1, 2}


@pytest.mark.parametrize("name", ["dasr", "ours", "ours/paper-appo"])
def test_tasks_that_draw_numbers_on_the_host_say_so_and_run_as_they_are(name):
    recorder = Tapes()
    state = TrainState(registry.training_task(name, "cpu"), TrainingConfig(), "cpu", recorder)
    assert "drawn by" in state.task.eager_reason
    state.train_sequence(sequence(0), 1.0, 1.0, 0.0)
    assert not recorder.tapes


def test_steps_are_recorded_on_a_gpu_alone(tmp_path):
    with pytest.raises(TrainingError, match="--graph records CUDA graphs, and cannot run on cpu"):
        train("oidn/tuned", [], [], tmp_path, TrainingConfig(graph=True))
