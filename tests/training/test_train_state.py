"""One sequence of a training: steps, averages, clipping, precision, and what stops it."""

from __future__ import annotations

import copy
from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from rlbench import registry
from rlbench.clips.procedural.clip import procedural
from rlbench.frames import Size
from rlbench.training.task import TrainingTask
from rlbench.training.train_state import NotFiniteError, TrainState

CLIP = procedural(0, Size(1, 16, 16), frames=1)


def learner(
    networks: nn.Module, *losses: Callable[[], Tensor], half: bool = False, **more: object
) -> TrainState:
    """One that takes a step for each of these losses."""
    trainer = TrainingTask(
        registry.method("mean"),
        networks,
        lambda clip, spp: (loss() for loss in losses),
        (1.0,),
        **{"peak": 1e-2, **more},
    )
    return TrainState(trainer, norm=1.0, average=0.998, half=half, device="cpu")


def pair(value: float = 1.0) -> nn.Sequential:
    """Two linear layers whose weights are all alike."""
    made = nn.Sequential(nn.Linear(3, 2), nn.Linear(2, 1))
    for weight in made.parameters():
        nn.init.constant_(weight, value)
    return made


def weights(module: nn.Module) -> list[Tensor]:
    return [weight.detach().clone() for weight in module.parameters()]


def test_the_average_follows_by_the_formula_of_its_decay():
    net, seen = pair(), []

    def loss() -> Tensor:
        seen.append(weights(net))
        return net(torch.ones(1, 3)).sum().square()

    taught = learner(net, loss, loss, loss)
    taught.sequence(CLIP, 1.0, 1.0, 0.0)
    wanted, after = seen[0], [*seen[1:], weights(net)]
    for step, now in enumerate(after):  # the decay rises from 1/10 towards 0.998
        keep = min(0.998, (1 + step) / (10 + step))
        wanted = [keep * old + (1 - keep) * new for old, new in zip(wanted, now, strict=True)]
    torch.testing.assert_close(weights(taught.average), wanted)
    assert not torch.equal(weights(taught.average)[0], weights(net)[0])


def test_counters_of_the_average_are_those_of_the_networks():
    net = nn.Sequential(nn.BatchNorm1d(3), nn.Linear(3, 1))
    taught = learner(net, *[lambda: net(torch.randn(4, 3)).sum()] * 3)
    taught.sequence(CLIP, 1.0, 1.0, 0.0)
    assert int(taught.average[0].num_batches_tracked) == 3


@pytest.mark.parametrize(("gain", "length"), [(1e6, 1.0), (1e-3, 1e-3)])
def test_gradients_are_clipped_to_a_length_and_shorter_ones_are_left(gain, length):
    net = nn.Linear(4, 1, bias=False)
    nn.init.zeros_(net.weight)
    learner(net, lambda: gain * net(torch.full((1, 4), 0.5)).sum()).sequence(CLIP, 1.0, 1.0, 0.0)
    assert float(net.weight.grad.norm()) == pytest.approx(
        length, rel=1e-4
    )  # of gain * (.5, .5, ..)


def test_a_network_aside_learns_and_does_not_shorten_the_others_gradients():
    net, critic = nn.Linear(1, 1, bias=False), nn.Linear(1, 1, bias=False)
    before, one = weights(critic)[0], torch.ones(1, 1)
    loss = lambda: 0.5 * net(one).sum() + 1e6 * critic(one).sum()  # noqa: E731
    learner(net, loss, aside=critic).sequence(CLIP, 1.0, 1.0, 0.0)
    assert float(net.weight.grad) == pytest.approx(0.5)
    assert critic.weight.item() == pytest.approx(before.item() - 1e-2, rel=1e-4)  # Adam's first


def test_a_network_without_children_learns():
    net = nn.Linear(1, 1)
    before = weights(net)
    learner(net, lambda: net(torch.ones(1, 1)).sum()).sequence(CLIP, 1.0, 1.0, 0.0)
    assert not torch.equal(before[0], net.weight)


def test_a_child_learns_at_its_share_of_the_rate():
    net = pair()
    taught = learner(net, lambda: net(torch.ones(1, 3)).sum(), shares={"1": 0.25})
    taught.sequence(CLIP, 1.0, 0.5, 0.0)
    moved = [1 - float(weight.detach().flatten()[0]) for weight in net.parameters()]
    assert moved == pytest.approx([5e-3, 5e-3, 1.25e-3, 1.25e-3], rel=1e-3)  # Adam's first step


@pytest.mark.parametrize(("half", "dtype"), [(False, torch.float32), (True, torch.bfloat16)])
def test_the_forward_pass_alone_is_in_half_precision(half, dtype):
    net, found = nn.Conv2d(1, 1, 3), []

    def loss() -> Tensor:
        found.append(net(torch.ones(1, 1, 8, 8)))
        return found[-1].float().mean()

    learner(net, loss, half=half).sequence(CLIP, 1.0, 1.0, 0.0)
    assert found[0].dtype == dtype
    assert (net.weight.dtype, net.weight.grad.dtype) == (torch.float32, torch.float32)


def test_a_gradient_that_is_not_finite_is_told_where_it_is():
    net = pair()
    near = lambda: net[1](net[0](torch.ones(1, 3)).detach())  # noqa: E731
    taught = learner(net, lambda: (near() - near().detach()).sqrt().sum())
    with pytest.raises(NotFiniteError) as raised:
        taught.sequence(CLIP, 1.0, 1.0, 0.0)
    assert raised.value.found.layers == ("1.weight", "1.bias")


@pytest.mark.parametrize(
    ("loss", "what"),
    [
        (lambda out: out * float("nan"), "loss is nan"),
        (lambda out: out + float("inf"), "loss is inf"),
        (lambda out: (out - out.detach()).sqrt(), "length of the gradient of the networks is"),
    ],
)
def test_a_step_that_is_not_finite_is_not_taken(loss, what):
    net = pair()
    fine = lambda: net(torch.ones(1, 3)).sum()  # noqa: E731
    taught = learner(net, fine, lambda: loss(fine()))
    moments = []
    after: list[Tensor] = []

    def watched(clip: object, spp: float) -> object:
        yield fine()
        after.extend(weights(net))
        moments.append(copy.deepcopy(taught.optimizer.state_dict()))
        yield loss(fine())

    taught.trainer.__dict__["losses"] = watched
    with pytest.raises(NotFiniteError, match=what) as raised:
        taught.sequence(CLIP, 1.0, 1.0, 0.0)
    assert raised.value.found.step == 1
    torch.testing.assert_close(weights(net), after, rtol=0, atol=0)
    torch.testing.assert_close(taught.optimizer.state_dict(), moments[0], rtol=0, atol=0)
