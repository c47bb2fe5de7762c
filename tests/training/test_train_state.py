"""One sequence of a run: steps, averages, anchors, precision, faults; and its validation."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.training import TrainingConfig, TrainingError, TrainingTask
from rlbench.training.optimizer_step import NonFiniteStepError
from rlbench.training.train_state import TrainState, validation_budgets
from tests.conftest import write_noise
from tests.learning_plugin import write_learner

CLIP = procedural_clip(0, Size(1, 16, 16), frames=1)


def train_state(
    networks: nn.Module,
    *losses: Callable[[], Tensor],
    bf16: bool = False,
    anchor: float = 0.0,
    **fields: object,
) -> TrainState:
    """A state that takes a step for each of these losses."""
    task = TrainingTask(
        registry.load_method("mean"),
        networks,
        lambda clip, spp: (loss() for loss in losses),
        (1.0,),
        **{"max_lr": 1e-2, **fields},
    )
    return TrainState(task, TrainingConfig(bf16=bf16, anchor=anchor), device="cpu")


def train(state: TrainState, lr_factor: float = 1.0) -> float:
    """One sequence."""
    return state.train_sequence(CLIP, 1.0, lr_factor, 0.0)


def two_layers(value: float = 1.0) -> nn.Sequential:
    """Two linear layers whose weights all have one value."""
    networks = nn.Sequential(nn.Linear(3, 2), nn.Linear(2, 1))
    for weight in networks.parameters():
        nn.init.constant_(weight, value)
    return networks


def weights(module: nn.Module) -> list[Tensor]:
    return [weight.detach().clone() for weight in module.parameters()]


@pytest.mark.parametrize("decay", [0.998, 0.2])
def test_the_average_follows_the_weights_as_by_the_formula(decay):
    torch.manual_seed(0)
    network, history = nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4), nn.Linear(4, 1)), []

    def loss() -> Tensor:
        history.append(copy.deepcopy(network.state_dict()))
        return network(torch.randn(5, 3)).sum().square()

    state = train_state(network, *[loss] * 30)
    state = TrainState(state.task, TrainingConfig(ema_decay=decay), "cpu")
    train(state)
    initial, *later = [*history, network.state_dict()]
    # buffers of batch norm change in the forward pass, after `history` was recorded
    expected = {name: tensor.clone() for name, tensor in initial.items()}
    for step, current in enumerate(later):
        rate = 1 - min(decay, (1 + step) / (10 + step))  # the decay rises from 1/10
        for name, tensor in expected.items():
            if tensor.is_floating_point():
                tensor.lerp_(current[name], rate)
            else:
                tensor.copy_(current[name])
    torch.testing.assert_close(state.average.state_dict(), expected, rtol=0, atol=1e-6)  # rounding
    assert not torch.equal(weights(state.average)[0], weights(network)[0])
    assert state.steps == 30


@pytest.mark.parametrize(("gain", "norm"), [(1e6, 1.0), (1e-3, 1e-3)])
def test_long_gradients_are_clipped_and_short_ones_are_left(gain, norm):
    network = nn.Linear(4, 1, bias=False)
    nn.init.zeros_(network.weight)
    train(train_state(network, lambda: gain * network(torch.full((1, 4), 0.5)).sum()))
    # the gradient is gain * (0.5, 0.5, 0.5, 0.5)
    assert float(network.weight.grad.norm()) == pytest.approx(norm, rel=1e-4)


def test_an_auxiliary_network_learns_and_does_not_shorten_the_others_gradients():
    network, critic = nn.Linear(1, 1, bias=False), nn.Linear(1, 1, bias=False)
    before, one = weights(critic)[0], torch.ones(1, 1)
    loss = lambda: 0.5 * network(one).sum() + 1e6 * critic(one).sum()  # noqa: E731
    train(train_state(network, loss, auxiliary_network=critic))
    assert float(network.weight.grad) == pytest.approx(0.5)
    assert critic.weight.item() == pytest.approx(before.item() - 1e-2, rel=1e-4)  # Adam's first


def test_a_child_and_an_auxiliary_network_learn_at_their_multiples_of_the_rate():
    network, critic = two_layers(), nn.Linear(1, 1, bias=False)
    before, one = weights(critic)[0].item(), torch.ones(1, 1)
    multipliers = {"1": 0.25, "auxiliary_network": 0.1}
    loss = lambda: network(torch.ones(1, 3)).sum() + critic(one).sum()  # noqa: E731
    state = train_state(network, loss, auxiliary_network=critic, lr_multipliers=multipliers)
    train(state, lr_factor=0.5)
    steps = [1 - float(weight.detach().flatten()[0]) for weight in network.parameters()]
    steps.append(before - critic.weight.item())
    assert steps == pytest.approx([5e-3, 5e-3, 1.25e-3, 1.25e-3, 5e-4], rel=1e-3)  # Adam's first


@pytest.mark.parametrize("anchor", [0.0, 30.0, float("inf")])
def test_a_weight_that_was_trained_before_is_pulled_to_its_start(anchor):
    networks, rate = two_layers(), 1e-2
    nn.init.zeros_(networks[0].weight[:, 1:])  # new channels
    loss = lambda: networks(torch.ones(1, 3)).sum()  # noqa: E731
    train(train_state(networks, *[loss] * 4, pretrained=("0.",), anchor=anchor))
    moved = 0.0
    for _ in range(4):  # steps of Adam are as long as the rate, since the gradient is constant
        # the new point x is the least of (x - y)^2 / (2 rate) + anchor / 2 (x - 1)^2
        moved = (moved + rate) / (1 + rate * anchor)
    free = 4 * rate
    assert networks[0].weight.detach().numpy() == pytest.approx(
        torch.tensor([[1 - moved, -free, -free]] * 2).numpy(), rel=1e-3, abs=1e-7
    )
    assert float(networks[1].weight[0, 0].detach()) == pytest.approx(
        1 - free, rel=1e-3
    )  # not named


def test_an_anchor_needs_weights_that_were_trained_before():
    with pytest.raises(TrainingError, match="--anchor"):
        train_state(two_layers(), anchor=1.0)


@pytest.mark.parametrize(("bf16", "dtype"), [(False, torch.float32), (True, torch.bfloat16)])
def test_only_the_forward_pass_is_in_bfloat16(bf16, dtype):
    network, outputs = nn.Conv2d(1, 1, 3), []

    def loss() -> Tensor:
        outputs.append(network(torch.ones(1, 1, 8, 8)))
        return outputs[-1].float().mean()

    train(train_state(network, loss, bf16=bf16))
    assert outputs[0].dtype == dtype
    assert (network.weight.dtype, network.weight.grad.dtype) == (torch.float32, torch.float32)


def test_the_error_names_the_layers_whose_gradients_are_not_finite():
    network = two_layers()
    last = lambda: network[1](network[0](torch.ones(1, 3)).detach())  # noqa: E731
    state = train_state(network, lambda: (last() - last().detach()).sqrt().sum())
    with pytest.raises(NonFiniteStepError) as raised:
        train(state)
    assert raised.value.layers == ["1.weight", "1.bias"]
    many = str(NonFiniteStepError("loss", float("nan"), 2, "abcde"))
    assert many == "loss is nan at step 2 of the training, not finite in a, b, c and 2 more"


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (lambda out: out * float("nan"), "loss is nan"),
        (lambda out: out + float("inf"), "loss is inf"),
        (lambda out: (out - out.detach()).sqrt(), "gradient norm of the networks is"),
    ],
)
def test_a_step_that_is_not_finite_is_not_taken(fault, message):
    network = two_layers()
    loss = lambda: network(torch.ones(1, 3)).sum()  # noqa: E731
    state = train_state(network, loss, lambda: fault(loss()))
    moments = []
    after: list[Tensor] = []

    def losses(clip: object, spp: float) -> object:
        yield loss()
        after.extend(weights(network))
        moments.append(copy.deepcopy(state.step.optimizer.state_dict()))
        yield fault(loss())

    state.task.__dict__["losses"] = losses
    with pytest.raises(NonFiniteStepError, match=message) as raised:
        train(state)
    assert raised.value.step == 1
    torch.testing.assert_close(weights(network), after, rtol=0, atol=0)
    torch.testing.assert_close(state.step.optimizer.state_dict(), moments[0], rtol=0, atol=0)


@pytest.mark.parametrize(
    ("training_budgets", "requested", "expected"),
    [((1.0, 2.0), (), [1.0, 4.0]), ((1.0, 2.0), (0.5, 3.0, 2.0), [0.5, 3.0])],
)
def test_validation_is_at_1_and_4_spp_or_at_the_ends_of_the_requested_budgets(
    training_budgets, requested, expected
):
    mean = registry.load_method("mean")
    assert validation_budgets(mean, training_budgets, requested) == expected


def blur_state(folder: Path, *spp: float) -> TrainState:
    registry.use_plugin(write_learner(folder))
    return TrainState(registry.training_task("blur"), TrainingConfig(spp=spp), "cpu")


def test_each_set_has_a_mean_of_its_own_and_one_of_first_frames(tmp_path):
    sets = {
        name: [write_noise(tmp_path / name, h=24, w=24, frames=frames, pool_spp=2)]
        for name, frames in (("short", 1), ("longer", 3))
    }
    result = blur_state(tmp_path, 1.0, 4.0).validate(sets)  # 4 spp: 2 are stored
    assert result.sets["short"].psnr == result.sets["short"].first_frames
    assert result.sets["longer"].psnr != result.sets["longer"].first_frames
    assert (result.sets["short"].drift, result.sets["longer"].drift == 0) == (0, False)
    assert result.psnr == sum(score.psnr for score in result.sets.values()) / 2
    assert blur_state(tmp_path, 1.0, 2.0).validate(sets).sets == result.sets


def test_averaged_weights_are_scored_and_the_networks_keep_theirs(tmp_path):
    sets = {"noise": [write_noise(tmp_path / "noise", h=24, w=24)]}
    state = blur_state(tmp_path, 1.0)
    own = state.validate(sets)
    nn.init.zeros_(state.average.weight)  # a black image
    before = weights(state.networks)
    black = state.validate(sets)
    torch.testing.assert_close(weights(state.networks), before, rtol=0, atol=0)
    assert black.psnr != own.psnr
    assert black.preview.shape == (3, 24, 48)
    assert torch.equal(black.preview[..., :24], torch.zeros(3, 24, 24))
