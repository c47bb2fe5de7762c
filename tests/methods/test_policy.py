"""The policy optimisers: each on problems whose best answer is known."""

from __future__ import annotations

import importlib.util
import itertools
import sys
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from methods.ours.experiments import compare_learners
from methods.ours.experiments.evaluation import Evaluation, Scenes
from methods.ours.experiments.known_optimum import (
    MODES,
    Direct,
    Filter,
    Mode,
    ToyProblem,
    density,
    greedy,
)
from methods.ours.experiments.toy_scenes import CHANNELS, FRAMES, scenes
from methods.ours.method import density as wished
from methods.ours.policy import (
    LEARNERS,
    BlockPolicyGradient,
    CombinedLearner,
    RolloutBatch,
    SamplerLearner,
    appo,
    appo_config,
    critic,
    learner,
)
from methods.ours.policy.block_reinforce import BlockReinforce
from methods.ours.policy.gamma_gradient import gamma_each
from methods.ours.policy.surrogate_gradient import pull_each
from rlbench.frames import Frame, GBuffer, Reference, Samples
from rlbench.sampling import allocate_counts

SIDE = 24
NEEDED = {  # in 200 steps
    "ppo-pixel": 0.7,
    "ppo-pixel+surrogate": 0.75,
    "critic": 0.35,
    "surrogate": 0.8,
    "gamma": 0.7,
}


class Free(nn.Module):
    """A sampler without a network: one action a pixel, whatever is seen."""

    def __init__(self):
        super().__init__()
        self.free = nn.Parameter(torch.zeros(1, 1, SIDE, SIDE))

    def forward(self, seen: Tensor) -> Tensor:
        return torch.tanh(self.free)


def pixels(priced: float = 1.0) -> BlockReinforce:
    return BlockReinforce(BlockPolicyGradient(block=1, margin=0, price_weight=priced))


def moment(mode: Mode | None = None, **settings: int) -> ToyProblem:
    frame = next(scenes(0, n=1, side=SIDE))
    return ToyProblem(frame, mode or Direct(), Free(), **settings)


def learned(way: SamplerLearner, steps: int = 200) -> float:
    """Share of the optimal reduction of error of one frame, whose samples are new in every step."""
    generator, first = torch.Generator().manual_seed(0), moment(floor=way.floor)
    sampler = first.sampler
    beside = list(way.network.parameters()) if way.network else []
    rates = [{"params": sampler.parameters(), "lr": 0.05}, {"params": beside, "lr": 5e-3}]
    optimizer = torch.optim.Adam(rates)
    for _ in range(steps):
        optimizer.zero_grad()
        way.loss(replace(first, field=first.field.again(generator)), generator).backward()
        optimizer.step()
    return share(first, first.buy(sampler(first.seen)))


def share(case: ToyProblem, counts: Tensor) -> float:
    best = greedy(case.field.sigma, case.spp * SIDE * SIDE)
    uniform = torch.full_like(best, case.spp)
    errors = [float(case.expected(n.float()).mean()) for n in (uniform, counts, best)]
    return (errors[0] - errors[1]) / (errors[0] - errors[2])


@pytest.mark.parametrize("name", LEARNERS)
def test_every_learner_finds_a_known_optimum(name):
    """A free action for each pixel, trained by the learner's loss alone, at 4 spp."""
    single = {
        "ppo-pixel": pixels(),
        "ppo-pixel+surrogate": CombinedLearner(pixels()),
    }  # not in blocks
    assert learned(single.get(name) or learner(name, CHANNELS)) > NEEDED[name]


@pytest.mark.parametrize("spp", [0.5, 1, 4])
def test_trial_and_gradient_add_up_from_one_sample_a_pixel_on(spp):
    def loss(way: SamplerLearner) -> Tensor:
        asked = moment(spp=spp)
        way.loss(asked, torch.Generator().manual_seed(0)).backward()
        return asked.sampler.free.grad

    trial, gradient = (
        BlockReinforce(BlockPolicyGradient(block=1, margin=0)),
        learner("surrogate", CHANNELS),
    )
    expected = loss(trial) + (loss(gradient) if spp >= 1 else 0)
    torch.testing.assert_close(loss(CombinedLearner(trial)), expected)


def test_a_price_on_samples_pays():
    assert learned(pixels(priced=0.0)) < learned(pixels()) - 0.08


def test_a_uniform_map_scores_zero():
    exam = Evaluation.of(Direct(), frames=1, n=2, side=16)
    assert exam.score(lambda seen: torch.zeros_like(seen[:, :1])) == pytest.approx(0, abs=1e-6)


def test_a_random_map_scores_less_than_a_uniform_one():
    exam, generator = (
        Evaluation.of(Direct(), frames=1, n=2, side=16),
        torch.Generator().manual_seed(0),
    )
    assert exam.score(lambda seen: 2 * torch.rand(seen[:, :1].shape, generator=generator) - 1) < -1


def test_the_optimum_scores_one():
    exam = Evaluation.of(Direct(), frames=1, n=2, side=16)
    case = ToyProblem(exam.fields[0], Direct(), Free())
    best = greedy(case.field.sigma, 4 * 16 * 16)
    reached = case.expected(best.float()).mean((1, 2, 3))
    torch.testing.assert_close(reached, exam.best[0])


@pytest.mark.parametrize("cost", [1, 4, 7])
def test_greed_is_as_good_as_trying_everything(cost):
    sigma = torch.rand(1, 1, 2, 2, generator=torch.Generator().manual_seed(cost)) + 0.1
    tried = [
        torch.tensor(n).view(1, 1, 2, 2)
        for n in itertools.product(range(4), repeat=4)
        if sum(n) == cost
    ]
    errors = [float(Direct().error(sigma, sigma, n).sum()) for n in tried]
    found = greedy(sigma, cost, cap=3)
    assert found.sum() == cost
    assert float(Direct().error(sigma, sigma, found).sum()) == pytest.approx(min(errors))


def test_greed_follows_deviation():
    """n + 1/2 is proportional to sigma where rounding allows."""
    sigma = torch.tensor([0.5, 1.5, 2.5, 3.5]).view(1, 1, 2, 2)
    assert greedy(sigma, 6).flatten().tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("mode", MODES.values(), ids=MODES)
def test_the_expected_error_is_the_mean_of_realised_errors(mode):
    case, generator = moment(mode), torch.Generator().manual_seed(1)
    action = torch.rand(1, 1, 1, SIDE, SIDE, generator=generator) * 2 - 1
    fixed = case.field.keys
    drawn = [replace(case.field.again(generator), keys=fixed) for _ in range(400)]
    errors = torch.stack([replace(case, field=f).rollout(action).errors.mean() for f in drawn])
    expected = case.expected(case.buy(action[0]).float()).mean()
    # 4 standard errors of the mean
    assert abs(errors.mean() - expected) < 4 * errors.std() / len(errors) ** 0.5


def test_the_filter_has_the_error_of_a_slow_twin():
    generator = torch.Generator().manual_seed(0)
    sigma, truth = torch.rand(2, 1, 1, 6, 7, generator=generator)
    counts = torch.randint(5, (1, 1, 6, 7), generator=generator).float()
    line = (1, 4, 6, 4, 1)
    slow = torch.zeros(6, 7)
    for row, column in itertools.product(range(6), range(7)):
        total = bias = variance = 0.0
        for y, x in itertools.product(range(-2, 3), range(-2, 3)):
            at = (0, 0, row + y, column + x)
            if 0 <= at[2] < 6 and 0 <= at[3] < 7:
                weight = line[y + 2] * line[x + 2] * float(counts[at] + 0.5)
                total += weight
                bias += weight * float(truth[at] - truth[0, 0, row, column])
                variance += weight**2 * float(sigma[at]) ** 2 / float(counts[at] + 0.5)
        slow[row, column] = (variance + bias**2) / total**2
    torch.testing.assert_close(Filter().error(sigma, truth, counts)[0, 0], slow)


def test_scenes_are_the_same_from_the_same_seed():
    first, second = (next(scenes(3, n=1, side=16)) for _ in range(2))
    assert torch.equal(first.stored, second.stored)
    assert first.keys == second.keys


def taught(teach, counts: Tensor, due: Tensor) -> tuple[Samples, Samples, Tensor]:
    """Samples of a frame before and after they are taught, and the truth."""
    field = next(scenes(0, n=1, side=4))
    radiance = field.stored.expand(-1, -1, 3, -1, -1)
    truth = field.truth.expand(-1, 3, -1, -1)
    bought = Samples(radiance, counts)
    bought = replace(bought, radiance=radiance.where(bought.valid_mask, 0.0))
    pool = ToyProblem(field, Direct(), Free()).pool
    frame = Frame(0, GBuffer({}), pool, Reference(truth, truth))
    return bought, teach(bought, due, frame), truth


@pytest.mark.parametrize("teach", [pull_each, gamma_each])
def test_what_was_not_bought_stays_empty(teach):
    counts = torch.arange(16).view(1, 1, 4, 4) % 5
    bought, after, _ = taught(teach, counts, counts + 0.5)
    assert torch.equal(after.counts, counts)
    assert not after.radiance.where(~bought.valid_mask, 0.0).any()


def test_the_surrogate_shows_the_samples_as_they_are():
    counts = torch.arange(16).view(1, 1, 4, 4) % 5
    bought, after, _ = taught(pull_each, counts, counts + 0.5)
    assert torch.equal(after.radiance, bought.radiance)


def test_the_surrogates_gradient_is_that_of_a_slow_twin():
    counts = torch.arange(16).view(1, 1, 4, 4) % 5
    due = counts.float().requires_grad_()
    bought, after, truth = taught(pull_each, counts, due)
    weights = torch.rand(after.radiance.shape, generator=torch.Generator().manual_seed(0))
    (weights * after.radiance).sum().backward()  # weights stand for the gradient of a loss
    slow = torch.zeros(1, 1, 4, 4)
    for row, column in itertools.product(range(4), range(4)):
        n = int(counts[0, 0, row, column])
        for slot, colour in itertools.product(range(n), range(3)):
            at = (0, slot, colour, row, column)
            away = truth[0, colour, row, column] - bought.radiance[at]
            slow[0, 0, row, column] += weights[at] * away / n
    torch.testing.assert_close(due.grad, slow)


def test_the_gammas_mean_is_the_truth():
    counts, due = torch.full((1, 1, 4, 4), 3), torch.full((1, 1, 4, 4), 1e7)
    _, after, truth = taught(gamma_each, counts, due)  # ten million samples leave no noise
    torch.testing.assert_close(after.mean, truth, rtol=1e-2, atol=0)


def test_the_critics_regression_lowers_its_error():
    case, generator = moment(), torch.Generator().manual_seed(0)
    way = critic.learner(CHANNELS)
    optimizer = torch.optim.Adam(way.network.parameters(), 5e-3)

    def wrong() -> float:
        with torch.no_grad():
            return float(way.regression(list(way.network.replay.past)))

    way.loss(case, generator)
    before = wrong()
    for _ in range(40):
        optimizer.zero_grad()
        way.loss(case, generator).backward()
        optimizer.step()
    assert wrong() < 0.9 * before


def test_a_critic_that_was_saved_and_loaded_goes_on_as_if_it_had_not_been():
    def losses(way: critic.Critic, generator: torch.Generator, steps: int) -> list[float]:
        return [way.loss(moment(), generator).item() for _ in range(steps)]

    whole, generator = critic.learner(CHANNELS), torch.Generator().manual_seed(0)
    losses(whole, generator, 3)
    tensors = {key: value.clone() for key, value in whole.network.state_dict().items()}
    resumed, again = critic.learner(CHANNELS), torch.Generator()
    again.set_state(generator.get_state())
    resumed.network.load_state_dict(tensors)
    assert losses(resumed, again, 3) == losses(whole, generator, 3)
    assert len(resumed.network.replay.past) > 6


def test_the_critic_is_not_trained_by_what_it_foretells():
    """Its weights get the regression's gradient alone, or it would learn to promise."""
    case, generator = moment(), torch.Generator().manual_seed(0)
    way = critic.learner(CHANNELS)
    way.loss(case, generator).backward()
    found = {name: p.grad.clone() for name, p in way.network.named_parameters()}
    way.network.zero_grad()
    way.regression(list(way.network.replay.past)).backward()
    wanted = {name: p.grad for name, p in way.network.named_parameters()}
    torch.testing.assert_close(found, wanted)


def test_relaxed_counts_cost_the_budget():
    action = torch.rand(1, 1, SIDE, SIDE, generator=torch.Generator().manual_seed(0)) * 2 - 1
    due = moment(spp=2).relaxed(action)
    assert float(due.mean()) == pytest.approx(2, rel=1e-4)
    assert float(due.max()) <= 8


@pytest.mark.parametrize("name", ["rllib-appo", "sarsa"])
def test_an_unknown_learner_is_told_what_there_is(name):
    with pytest.raises(LookupError, match=name):
        learner(name, CHANNELS)


def test_a_world_cuts_its_episodes_after_twenty_frames():
    world = Scenes(Direct(), 0, side=8)
    world.reset()
    ends = [world.step(torch.zeros(1, 1, 8, 8)).over for _ in range(2 * FRAMES)]
    assert [at + 1 for at, over in enumerate(ends) if over] == [FRAMES, 2 * FRAMES]


def test_an_episode_ends_with_what_was_seen_last():
    world = Scenes(Direct(), 0, 8)
    world.reset()
    action = torch.zeros(1, 1, 8, 8)
    seen = [world.step(action).seen for _ in range(FRAMES)]
    assert torch.equal(seen[-1], seen[-2])  # and not the first of the next episode
    assert not torch.equal(seen[-2], seen[-3])


@pytest.mark.parametrize("words", [["--frames", "16"], ["--side", "20"]])
def test_a_comparison_that_cannot_be_made_is_refused(words, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["compare", "--out", str(tmp_path), *words])
    with pytest.raises(SystemExit):
        compare_learners.main()
    assert "it takes 32 frames or more, and a side that divides by 8" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_missing_extra_is_told_with_what_would_do(monkeypatch):
    monkeypatch.setattr(appo, "NEEDED", ("no_such_package",))
    with pytest.raises(appo.MissingError, match=r"no_such_package.*rlbench\[train\].*ppo-pixel"):
        appo.train(lambda: Scenes(Direct(), 0), Free, frames=1)


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("gymnasium") is None, reason="needs ray[rllib] and gymnasium"
)
def test_rllib_learns_by_single_pixels():
    exam = Evaluation.of(Direct(), frames=1, n=4, side=SIDE)
    world = lambda: Scenes(Direct(), 0, SIDE)  # noqa: E731
    trained = appo.train(
        world, lambda: compare_learners.network(0), 1500, appo_config.Appo(rate=2e-3)
    )
    assert exam.score(trained) > 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["true gradient", "ppo-pixel", "ppo-pixel+surrogate", "critic", "surrogate", "gamma"]
)
def test_every_learner_trains_the_real_sampler(name):
    """On moving scenes that it has not seen it beats uniform sampling clearly."""
    scores: list[float] = []
    exam = Evaluation.of(Direct(), frames=1, n=4, side=32)
    compare_learners.by_torch(name, exam, 0, 1200, lambda *told: scores.append(told[-1]))
    assert scores[-1] > 0.4


@pytest.mark.parametrize("corner", [(0, 0), (3, 5)])
def test_noise_is_the_same_all_over_a_block_and_differs_between_blocks(corner):
    policy, mean = BlockPolicyGradient(), torch.zeros(2, 1, 30, 41)
    drawn = policy.explore(mean, corner, torch.Generator().manual_seed(0))
    row, column = corner
    whole = drawn[..., row : row + 24, column : column + 32].unfold(2, 8, 8).unfold(3, 8, 8)
    assert whole.flatten(4).std(-1).max() < 1e-6
    assert whole[..., 0, 0].unique().numel() == 2 * 3 * 4


@pytest.mark.parametrize("factors", [False, True])
def test_the_policy_gradient_is_that_of_the_error_at_a_fixed_budget(factors):
    """Pixels by themselves that are sold by fractions: n samples leave sigma^2 / n."""
    generator = torch.Generator().manual_seed(0)
    sigma = torch.rand(1, 1, 8, 8, generator=generator) + 0.5
    mean = (torch.rand(1, 1, 8, 8, generator=generator) * 1.8 - 0.9).requires_grad_()

    def error(action: Tensor) -> tuple[Tensor, Tensor]:
        wish = wished(action, "exponential" if factors else "linear")
        counts = 4 * wish / wish.mean((-2, -1), keepdim=True)
        return sigma.square() / counts, counts

    (true,) = torch.autograd.grad(error(mean)[0].sum(), mean)
    policy = BlockPolicyGradient(action_std=0.02, draws=8192, block=1, margin=0, advantage_clip=1e9)
    actions = policy.antithetic_actions(mean, (0, 0), generator)
    policy.loss(mean, RolloutBatch(actions, *error(actions), (0, 0), factors)).backward()
    found = mean.grad - torch.autograd.grad(mean.mean().square(), mean)[0]  # less the drift
    likeness = F.cosine_similarity(found.flatten(), true.flatten(), dim=0)
    assert likeness > 0.998  # noise of the draws: 0.001; with the other coupling 0.95 and less


def test_blocks_of_noisy_pixels_are_given_more_where_single_pixels_tell_nothing():
    """A quarter of the image is four times as noisy, but every error is spread over 9x9 pixels."""
    generator = torch.Generator().manual_seed(0)
    policy, spread = BlockPolicyGradient(), torch.nn.AvgPool2d(9, 1, 4, count_include_pad=False)
    sigma = torch.ones(1, 1, 48, 48)
    sigma[..., 24:, 24:] = 4.0
    free = torch.zeros_like(sigma, requires_grad=True)
    optimizer = torch.optim.Adam([free], 0.03)
    nothing, cost = torch.zeros(1, 1, 48, 48, dtype=torch.int64), 2 * 48 * 48
    for step in range(150):
        mean, corner = torch.tanh(free), policy.corner(generator)
        actions = policy.antithetic_actions(mean, corner, generator)
        counts = torch.stack(
            [allocate_counts(density(a), cost, nothing, 8, (step,)) for a in actions]
        )
        errors = spread((sigma.square() / (counts + 0.5)).flatten(0, 1)).unflatten(0, (-1, 1))
        optimizer.zero_grad()
        policy.loss(mean, RolloutBatch(actions, errors, counts.float(), corner)).backward()
        optimizer.step()
    found = torch.tanh(free.detach())
    assert found[..., 28:, 28:].mean() > 0.5
    assert found[..., :20, :20].mean() < 0


@pytest.mark.parametrize("corner", [(0, 0), (3, 5), (7, 1)])
def test_a_block_is_summed_with_the_margin_that_there_is_around_it(corner):
    """Also above and to the left of the first whole block."""
    policy = BlockPolicyGradient(block=8, margin=4)
    values = torch.rand(2, 1, 1, 37, 45, generator=torch.Generator().manual_seed(0))
    found = policy._blocks(values, corner, policy.margin)
    for i, j in itertools.product(range(found.shape[-2]), range(found.shape[-1])):
        top, left = corner[0] + 8 * i, corner[1] + 8 * j
        around = values[..., max(top - 4, 0) : top + 12, max(left - 4, 0) : left + 12]
        torch.testing.assert_close(found[..., i, j], around.sum((-1, -2)))


def test_trainings_of_other_lengths_are_not_put_into_one_table(tmp_path):
    table = tmp_path / compare_learners.TABLE
    compare_learners.compare(table, 16, 16, [0], ["surrogate"], ["direct"])
    with pytest.raises(ValueError, match=r"--frames 16 --side 16.*--frames 64 --side 16.*--out"):
        compare_learners.compare(table, 64, 16, [0], ["surrogate"], ["direct"])
