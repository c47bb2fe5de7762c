"""Online cross-regression: regression, filter and loss equal loops; the learner follows Adam."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.cross.bilateral import filter_pilots
from baselines.cross.method import (
    LOSS_OFFSET,
    Cross,
    Screened,
    build,
    learn_elsewhere,
    screen,
    self_supervised_loss,
)
from baselines.cross.network import INPUTS, LAYERS, PARAMETERS, Learner, predict, random_weights
from baselines.cross.pilots import mirror, regress, split_halves
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import GBuffer, Samples, Size
from rlbench.run import run_clip, unroll
from tests.baselines import regression_twins as twins
from tests.baselines.noise import array, random_tensor

CPU = torch.device("cpu")
SIZE = Size(1, 24, 32)


def normals(h: int, w: int) -> Tensor:
    return torch.nn.functional.normalize(random_tensor(1, 3, h, w, seed=9) - 0.5, dim=1)


def run(method: Cross, frames: int = 3, **changed) -> list:
    return list(run_clip(method, procedural_clip(3, SIZE, frames, **changed), spp=2.0))


def test_the_halves_are_the_even_and_the_odd_samples():
    """And the only sample is in both."""
    radiance = random_tensor(1, 5, 3, 1, 3)
    counts = torch.tensor([5, 2, 1]).view(1, 1, 1, 3)
    radiance[:, 2:, :, :, 1] = radiance[:, 1:, :, :, 2] = 0
    first, second = split_halves(Samples(radiance, counts))
    torch.testing.assert_close(first[..., 0], radiance[:, [0, 2, 4], :, :, 0].mean(1))
    torch.testing.assert_close(second[..., 0], radiance[:, [1, 3], :, :, 0].mean(1))
    assert torch.equal(first[..., 1], radiance[:, 0, :, :, 1])
    assert torch.equal(second[..., 1], radiance[:, 1, :, :, 1])
    assert torch.equal(first[..., 2], second[..., 2])


@pytest.mark.parametrize("size", [(1, 1), (3, 17), (9, 10)], ids=str)
def test_borders_are_mirrored_at_any_size(size):
    image = random_tensor(1, 1, *size)
    expected = np.pad(image[0, 0].numpy(), 8, mode="reflect")
    assert torch.equal(mirror(image, 8)[0, 0], torch.from_numpy(expected))


@pytest.mark.parametrize("size", [(13, 18), (9, 21)], ids=str)
def test_regression_is_that_of_numpy_window_by_window(size):
    h, w = size
    halves = [random_tensor(1, 3, h, w, seed=seed) + 0.5 for seed in (1, 2)]
    albedo = random_tensor(1, 3, h, w, seed=3)
    images = (*halves, albedo, normals(h, w))
    expected = twins.cross_regression(*map(array, images))
    np.testing.assert_allclose(array(regress(*images)), expected, rtol=2e-3)  # float32


@pytest.mark.parametrize("size", [(7, 19), (13, 8)], ids=str)
def test_the_filter_is_that_of_loops(size):
    h, w = size
    pilots, surface, bands = (random_tensor(1, c, h, w, seed=c) for c in (6, 7, 5))
    bands = bands * torch.tensor([9.0, 5, 3, 2, 1]).view(1, 5, 1, 1)
    found = filter_pilots(pilots, surface[:, :6], bands)[0].permute(2, 3, 0, 1)
    expected = twins.cross_bilateral(array(pilots), array(surface)[..., :6], array(bands))
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_the_gradient_by_the_bands_is_that_of_differences():
    pilots, surface = (random_tensor(2, 6, 7, 9, seed=seed).double() for seed in (0, 1))
    bands = (1 + random_tensor(2, 5, 7, 9, seed=2)).double().requires_grad_()
    # along random directions: all of them would take a minute
    assert torch.autograd.gradcheck(
        lambda b: filter_pilots(pilots, surface, b), bands, fast_mode=True
    )


def test_the_gradient_of_a_step_is_that_of_differences():
    """By all weights of the last layer and some of each other, through filter and loss."""
    inputs = random_tensor(1, INPUTS, 8, 8).double()
    pilots, last = inputs[:, :6], inputs[:, 6:9]
    start = random_weights(3).double()[None]
    chosen = torch.cat(
        (torch.arange(0, PARAMETERS, 997), torch.arange(PARAMETERS - 54, PARAMETERS))
    )

    def loss(values: Tensor) -> Tensor:
        weights = start.index_copy(1, chosen, values[None])
        bands, alpha = predict(weights, inputs)
        sums = filter_pilots(pilots, inputs[:, 9:], bands)
        halves = (sums[:, :, :3] / sums[:, :, 3:]).flatten(1, 2)
        halves = torch.lerp(last.repeat(1, 2, 1, 1), halves, alpha)
        everywhere = torch.ones_like(alpha, dtype=torch.bool)
        return self_supervised_loss(halves, pilots, pilots.flip(2), everywhere)

    assert torch.autograd.gradcheck(loss, start[0, chosen].clone().requires_grad_())


def test_the_loss_by_hand_on_two_by_two_pixels():
    """Halves A = 1, B = 2; pilots A = 2, B = 4; of the last frame 3 and 5; one pixel has none."""
    shape = (1, 3, 2, 2)
    halves, pilots, old = (
        torch.cat((torch.full(shape, a), torch.full(shape, b)), 1)
        for a, b in ((1.0, 2.0), (2.0, 4.0), (3.0, 5.0))
    )
    surface = torch.tensor([[True, True], [True, False]]).view(1, 1, 2, 2)
    spatial = ((1 - 4) ** 2 / (16 + LOSS_OFFSET) + 0.0) / 2  # B is pilot A
    temporal = ((1 - 3) ** 2 / (9 + LOSS_OFFSET) + (2 - 5) ** 2 / (25 + LOSS_OFFSET)) / 2
    expected = 3 / 4 * (spatial + temporal) / 2
    found = self_supervised_loss(halves, pilots, old, surface)
    torch.testing.assert_close(found, torch.tensor([expected]))


def test_the_network_has_the_published_layers():
    assert PARAMETERS == 31_414  # by hand; its authors say about 30,000
    assert [after for _, after, side in LAYERS if side == 3] == [8, 8, 16, 16, 32, 32, 16, 16, 8]


def test_steps_are_those_of_adam_in_torch():
    start = random_tensor(50)
    parameter = start.clone().requires_grad_()
    adam = torch.optim.Adam([parameter], lr=1e-2, eps=1e-7)
    learner = Learner.begin(start, n=1)
    for seed in range(5):
        gradient = random_tensor(50, seed=seed) - 0.5
        parameter.grad = gradient.clone()
        adam.step()
        learner = learner.step(gradient[None], 1e-2)
    torch.testing.assert_close(learner.weights[0], parameter.detach())


def test_a_gradient_that_is_not_finite_leaves_the_weights():
    learner = Learner.begin(random_tensor(9), n=2)
    gradient = torch.ones(2, 9)
    gradient[0, 3] = torch.nan
    after = learner.step(gradient, 0.1)
    assert torch.equal(after.weights[0], learner.weights[0])
    assert (after.weights[1] < learner.weights[1]).all()


def test_the_last_output_is_kept_inside_the_range_of_the_window():
    """Pilots are 1 to 2 in a row; the last output leaves that range at one pixel of each kind."""
    pilots = torch.linspace(1, 2, 20).view(1, 1, 1, 20).expand(1, 6, 9, 20).contiguous()
    image, known = pilots[:, :3].clone(), torch.ones(1, 1, 9, 20, dtype=torch.bool)
    image[..., 4, 5] += 1.0  # above all of 7 x 7 pixels
    image[:, 1, 4, 12] -= 1.0  # below, in one channel alone
    known[..., 2, 2] = False
    found: Screened = screen(pilots, image, pilots, known)
    inner = found.fits[0, 0, :, 4:-4]
    rejected = {tuple(p) for p in (~inner).nonzero().tolist()}
    assert rejected == {(4, 1), (4, 8)}
    assert not found.fits[0, 0, 2, 2]
    assert torch.equal(found.image[..., 4, 5], pilots[:, :3, 4, 5])


def test_learning_lowers_the_loss_on_a_clip(monkeypatch):
    """The weights of a pass explain a frame better than those before: the loss is what it says."""
    method, losses = build("", CPU, None), []
    results = run(method, 16, still_camera=True)
    state, last = results[-2].state, results[-1]

    def keep(*arguments: Tensor) -> Tensor:
        loss = self_supervised_loss(*arguments)
        losses.append(float(loss.detach()))
        return loss

    monkeypatch.setattr("baselines.cross.method.self_supervised_loss", keep)
    for weights in (method.initial[None], last.state.learner.weights):
        learner = state.learner._replace(weights=weights)
        method.denoise(last.frame.gbuffer, last.samples, state._replace(learner=learner))
    assert losses[1] < losses[0]


def test_inference_mode_learns_as_gradients_do():
    method = build("", CPU, None)
    clip = procedural_clip(3, SIZE, 3)
    frames = zip(run_clip(method, clip, 2.0), unroll(method, clip, 2.0), strict=True)
    for one, other in frames:
        assert torch.equal(one.image, other.image)
        assert torch.equal(one.state.learner.weights, other.state.learner.weights)


def test_the_frozen_network_stays_and_is_not_random():
    method = build("frozen", CPU, None)
    *_, last = run(method)
    assert torch.equal(last.state.learner.weights[0], learn_elsewhere())
    assert not torch.equal(learn_elsewhere(), random_weights(method.config.seed))


def test_the_network_begins_anew_where_nothing_has_history():
    method = build("", CPU, None)
    first, second = run(method, 2)
    outside = {"motion": torch.full((1, 2, *SIZE[1:]), 1e3)}
    gbuffer = GBuffer({**second.frame.gbuffer.buffers, **outside})
    _, state = method.denoise(gbuffer, second.samples, first.state)
    assert [int(each.learner.steps) for each in (second.state, state)] == [2, 1]


@pytest.mark.parametrize("factor", [torch.nan, 65504.0])
def test_broken_weights_begin_anew(factor):
    method = build("", CPU, None)
    first, second = run(method, 2)
    learner = first.state.learner
    broken = first.state._replace(learner=learner._replace(weights=learner.weights * factor))
    image, state = method.denoise(second.frame.gbuffer, second.samples, broken)
    assert image.isfinite().all()
    assert float(state.learner.steps) == 1
