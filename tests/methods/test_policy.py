"""Sampler learners, each on problems with a known optimum."""

from __future__ import annotations

import importlib.util
import itertools
import sys
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from methods.ours.gradients import compare_learners
from methods.ours.gradients.toy_evaluation import TABLE, Evaluation, ToyEnv
from methods.ours.gradients.toy_problem import (
    CHANNELS,
    EPISODE_FRAMES,
    Direct,
    Filter,
    Mode,
    ToyProblem,
    greedy_counts,
    toy_density,
    toy_frames,
)
from methods.ours.method import DENSITIES
from methods.ours.policy import (
    LEARNERS,
    BlockPolicyGradient,
    BlockReinforce,
    CombinedLearner,
    CriticLearner,
    LearnerError,
    RolloutBatch,
    SamplerLearner,
    StochasticLearner,
    appo,
    gamma_gradient_per_sample,
    make_learner,
)
from methods.ours.policy.critic import make_critic_learner
from methods.ours.policy.learner import AllocationProblem
from methods.ours.policy.sample_gradients import kuznetsov_gradient_per_sample
from rlbench.frames import Frame, GBuffer, Reference, Samples
from rlbench.sampling import allocate_counts
from tests.baselines.noise import read_samples

SIDE = 24
LEAST_SCORE = {  # after 200 steps
    "reinforce": 0.7,
    "reinforce+surrogate": 0.75,
    "critic": 0.35,
    "surrogate": 0.8,
    "gamma": 0.7,
    "stochastic": 0.7,
}


BLOCKS = BlockPolicyGradient()


class FreeMap(nn.Module):
    """A sampler without a network: one action a pixel, for any observation."""

    def __init__(self):
        super().__init__()
        self.free = nn.Parameter(torch.zeros(1, 1, SIDE, SIDE))

    def forward(self, observation: Tensor) -> Tensor:
        return torch.tanh(self.free)


def single_pixels(price_weight: float = 1.0) -> BlockReinforce:
    return BlockReinforce(BlockPolicyGradient(block=1, margin=0, price_weight=price_weight))


def toy_problem(mode: Mode | None = None, **settings: int) -> ToyProblem:
    frame = next(toy_frames(0, n=1, side=SIDE))
    return ToyProblem(frame, mode or Direct(), FreeMap(), **settings)


def trained_score(learner: SamplerLearner, steps: int = 200) -> float:
    """Share of the optimal error reduction on one frame, which is resampled in every step."""
    generator = torch.Generator().manual_seed(0)
    first = toy_problem(min_samples=learner.min_samples)
    sampler = first.sampler
    aside = list(learner.network.parameters()) if learner.network else []
    rates = [{"params": sampler.parameters(), "lr": 0.05}, {"params": aside, "lr": 5e-3}]
    optimizer = torch.optim.Adam(rates)
    for _ in range(steps):
        optimizer.zero_grad()
        resampled = replace(first, frame=first.frame.resample(generator))
        learner.loss(resampled, generator).backward()
        optimizer.step()
    return score(first, first.draw_counts(sampler(first.observation)))


def score(problem: ToyProblem, counts: Tensor) -> float:
    best = greedy_counts(problem.frame.sigma, problem.spp * SIDE * SIDE)
    uniform = torch.full_like(best, problem.spp)
    errors = [float(problem.expected_error(n.float()).mean()) for n in (uniform, counts, best)]
    return (errors[0] - errors[1]) / (errors[0] - errors[2])


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name == "reinforce+surrogate" else name
        for name in LEARNERS
    ],
)
def test_every_learner_finds_a_known_optimum(name):
    """A free action for each pixel, trained by the learner's loss alone, at 4 spp."""
    without_blocks = {
        "reinforce": single_pixels(),
        "reinforce+surrogate": CombinedLearner(single_pixels()),
        "stochastic": StochasticLearner(block=1, margin=0),
    }
    learner = without_blocks.get(name) or make_learner(name, CHANNELS)
    assert trained_score(learner) > LEAST_SCORE[name]


@pytest.mark.parametrize("spp", [0.5, 1, 4])
def test_both_gradients_add_up_from_one_sample_per_pixel_on(spp):
    def gradient(loss: Callable[[AllocationProblem], Tensor]) -> Tensor:
        problem = toy_problem(spp=spp)
        loss(problem).backward()
        return problem.sampler.free.grad

    def policy_gradient(learner: SamplerLearner) -> Tensor:
        return gradient(lambda problem: learner.loss(problem, torch.Generator().manual_seed(0)))

    surrogate = gradient(lambda problem: problem.surrogate_loss(kuznetsov_gradient_per_sample))
    expected = policy_gradient(single_pixels()) + (surrogate if spp >= 1 else 0)
    torch.testing.assert_close(policy_gradient(CombinedLearner(single_pixels())), expected)


@pytest.mark.parametrize(("action", "is_pulled"), [(0.3, False), (1.0, True)])
def test_the_surrogate_learner_pulls_a_common_action_back_to_the_middle(action, is_pulled):
    problem = toy_problem(spp=2)
    with torch.no_grad():
        problem.sampler.free.add_(action)  # the budget cancels it
    make_learner("surrogate", CHANNELS).loss(problem, torch.Generator()).backward()
    gradient = problem.sampler.free.grad
    assert bool(gradient.mean() > 0.01 * gradient.abs().mean()) == is_pulled


@pytest.mark.slow
def test_a_price_on_samples_pays():
    assert trained_score(single_pixels(price_weight=0.0)) < trained_score(single_pixels()) - 0.08


def test_a_uniform_map_scores_zero_and_the_optimum_one():
    evaluation = Evaluation.of_mode(Direct(), frames=1, n=2, side=16)
    assert evaluation.score(lambda x: torch.zeros_like(x[:, :1])) == pytest.approx(0, abs=1e-6)
    problem = ToyProblem(evaluation.frames[0], Direct(), FreeMap())
    best = greedy_counts(problem.frame.sigma, 4 * 16 * 16)
    error = problem.expected_error(best.float()).mean((1, 2, 3))
    torch.testing.assert_close(error, evaluation.best[0])


@pytest.mark.parametrize("total", [1, 4, 7])
def test_greedy_counts_are_as_good_as_the_best_of_all_counts(total):
    sigma = torch.rand(1, 1, 2, 2, generator=torch.Generator().manual_seed(total)) + 0.1
    every = [n for n in itertools.product(range(4), repeat=4) if sum(n) == total]
    errors = [
        float(Direct().expected_error(sigma, sigma, torch.tensor(n).view(1, 1, 2, 2)).sum())
        for n in every
    ]
    counts = greedy_counts(sigma, total, max_samples=3)
    assert counts.sum() == total
    error = float(Direct().expected_error(sigma, sigma, counts).sum())
    assert error == pytest.approx(min(errors))


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
    torch.testing.assert_close(Filter().expected_error(sigma, truth, counts)[0, 0], slow)


def with_gradient(
    sample_gradient, counts: Tensor, relaxed: Tensor
) -> tuple[Samples, Samples, Tensor]:
    """Samples of a frame before and after `sample_gradient`, and the truth."""
    toy = next(toy_frames(0, n=1, side=4))
    pool, truth = ToyProblem(toy, Direct(), FreeMap()).pool, toy.truth.expand(-1, 3, -1, -1)
    frame = Frame(0, GBuffer({}), pool, Reference(truth, truth))
    samples = read_samples(frame, counts)
    return samples, sample_gradient(samples, relaxed, frame), truth


def test_empty_slots_stay_empty_and_the_surrogate_gradient_changes_no_value():
    counts = torch.arange(16).view(1, 1, 4, 4) % 5
    before, after, _ = with_gradient(gamma_gradient_per_sample, counts, counts + 0.5)
    assert torch.equal(after.counts, counts)
    assert not after.radiance.where(~before.valid_mask, 0.0).any()
    before, after, _ = with_gradient(kuznetsov_gradient_per_sample, counts, counts + 0.5)
    assert torch.equal(after.radiance, before.radiance)


def test_the_surrogate_gradient_equals_that_of_a_slow_twin():
    counts = torch.arange(16).view(1, 1, 4, 4) % 5
    relaxed = counts.float().requires_grad_()
    before, after, truth = with_gradient(kuznetsov_gradient_per_sample, counts, relaxed)
    weights = torch.rand(after.radiance.shape, generator=torch.Generator().manual_seed(0))
    (weights * after.radiance).sum().backward()  # weights stand for the gradient of a loss
    slow = torch.zeros(1, 1, 4, 4)
    for row, column in itertools.product(range(4), range(4)):
        n = int(counts[0, 0, row, column])
        for slot, colour in itertools.product(range(n), range(3)):
            at = (0, slot, colour, row, column)
            difference = truth[0, colour, row, column] - before.radiance[at]
            slow[0, 0, row, column] += weights[at] * difference / n
    torch.testing.assert_close(relaxed.grad, slow)


def test_the_mean_of_the_gamma_gradient_is_the_truth():
    counts, relaxed = torch.full((1, 1, 4, 4), 3), torch.full((1, 1, 4, 4), 1e7)
    _, after, truth = with_gradient(gamma_gradient_per_sample, counts, relaxed)
    # ten million samples leave no noise
    torch.testing.assert_close(after.mean, truth, rtol=1e-2, atol=0)


def test_a_critic_that_was_saved_and_loaded_continues_the_same_training():
    def losses(learner: CriticLearner, generator: torch.Generator, steps: int) -> list[float]:
        return [learner.loss(toy_problem(), generator).item() for _ in range(steps)]

    original, generator = make_critic_learner(CHANNELS), torch.Generator().manual_seed(0)
    losses(original, generator, 3)
    tensors = {key: value.clone() for key, value in original.network.state_dict().items()}
    resumed, again = make_critic_learner(CHANNELS), torch.Generator()
    again.set_state(generator.get_state())
    resumed.network.load_state_dict(tensors)
    assert losses(resumed, again, 3) == losses(original, generator, 3)
    assert len(resumed.network.replay.past) > 6


def test_the_critic_is_not_trained_by_its_own_prediction():
    """Its weights get the gradient of the regression alone, or it would learn to predict 0."""
    problem, generator = toy_problem(), torch.Generator().manual_seed(0)
    learner = make_critic_learner(CHANNELS)
    learner.loss(problem, generator).backward()
    of_loss = {name: p.grad.clone() for name, p in learner.network.named_parameters()}
    learner.network.zero_grad()
    learner.regression(list(learner.network.replay.past)).backward()
    of_regression = {name: p.grad for name, p in learner.network.named_parameters()}
    torch.testing.assert_close(of_loss, of_regression)


@pytest.mark.parametrize("name", ["appo", "rllib-appo", "sarsa"])
def test_an_unknown_learner_is_refused_by_name(name):
    with pytest.raises(LearnerError, match=name):
        make_learner(name, CHANNELS)


def test_episodes_are_truncated_after_twenty_frames_with_their_own_last_observation():
    env = ToyEnv(Direct(), 0, side=8)
    env.reset()
    steps = [env.step(torch.zeros(1, 1, 8, 8)) for _ in range(2 * EPISODE_FRAMES)]
    last = [number for number, step in enumerate(steps, start=1) if step.truncated]
    assert last == [EPISODE_FRAMES, 2 * EPISODE_FRAMES]
    *_, before, previous, end = (step.observation for step in steps[:EPISODE_FRAMES])
    assert torch.equal(end, previous)  # not the next episode's first
    assert not torch.equal(previous, before)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--frames", "16"], "--frames 16: give 32 or more"),
        (["--side", "20"], "--side 20: give a multiple of 8"),
        (["--learners", "sarsa"], "--learners: 'sarsa' is unknown"),
    ],
)
def test_a_comparison_that_cannot_be_made_is_refused(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["compare", "--out", str(tmp_path), *words])
    with pytest.raises(SystemExit):
        compare_learners.main()
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_missing_package_is_named_with_the_extra_to_install(monkeypatch):
    monkeypatch.setattr(appo, "NEEDED", ("no_such_package",))
    words = r"no_such_package.*rlbench\[train\].*reinforce"
    with pytest.raises(appo.MissingPackageError, match=words):
        appo.train(lambda: ToyEnv(Direct(), 0), FreeMap, frames=1)


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("gymnasium") is None, reason="needs ray[rllib] and gymnasium"
)
def test_rllib_learns_by_single_pixels():
    evaluation = Evaluation.of_mode(Direct(), frames=1, n=4, side=SIDE)
    trained = appo.train(
        lambda: ToyEnv(Direct(), 0, SIDE),
        lambda: compare_learners.initial_sampler(0),
        1500,
        appo.AppoSettings(learning_rate=2e-3),
    )
    assert evaluation.score(trained) > 0.3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["true gradient", *LEARNERS])
def test_every_learner_trains_the_real_sampler(name):
    """On unseen moving scenes it clearly beats uniform sampling."""
    scores: list[float] = []
    evaluation = Evaluation.of_mode(Direct(), frames=1, n=4, side=32)
    compare_learners.train_by_learner(
        name, evaluation, 0, 1200, lambda frames, seconds, score: scores.append(score)
    )
    assert scores[-1] > 0.4


@pytest.mark.parametrize("corner", [(0, 0), (3, 5)])
def test_noise_is_constant_within_a_block_and_differs_between_blocks(corner):
    policy, mean = BlockPolicyGradient(), torch.zeros(2, 1, 30, 41)
    action = policy.explore(mean, corner, torch.Generator().manual_seed(0))
    row, column = corner
    blocks = action[..., row : row + 24, column : column + 32].unfold(2, 8, 8).unfold(3, 8, 8)
    assert blocks.flatten(4).std(-1).max() < 1e-6
    assert blocks[..., 0, 0].unique().numel() == 2 * 3 * 4


@pytest.mark.parametrize("name", DENSITIES)
def test_the_policy_gradient_is_that_of_the_error_at_a_fixed_budget(name):
    """Independent pixels with fractional counts: n samples leave sigma^2 / n."""
    generator = torch.Generator().manual_seed(0)
    sigma = torch.rand(1, 1, 8, 8, generator=generator) + 0.5
    mean = (torch.rand(1, 1, 8, 8, generator=generator) * 1.8 - 0.9).requires_grad_()

    def error(action: Tensor) -> tuple[Tensor, Tensor]:
        shares = DENSITIES[name](action)
        counts = 4 * shares / shares.mean((-2, -1), keepdim=True)
        return sigma.square() / counts, counts

    (true,) = torch.autograd.grad(error(mean)[0].sum(), mean)
    policy = BlockPolicyGradient(action_std=0.02, draws=8192, block=1, margin=0, advantage_clip=1e9)
    actions = policy.antithetic_actions(mean, (0, 0), generator)
    batch = RolloutBatch(actions, *error(actions), (0, 0), name == "exponential")
    policy.loss(mean, batch).backward()
    gradient = mean.grad - torch.autograd.grad(mean.mean().square(), mean)[0]  # less the drift
    similarity = F.cosine_similarity(gradient.flatten(), true.flatten(), dim=0)
    assert similarity > 0.998  # noise of the draws: 0.001; with the other coupling 0.95 and less


def random_batch(mean: Tensor, policy: BlockPolicyGradient) -> RolloutBatch:
    """Actions around the mean, with random errors and counts, that multiply the density."""
    generator = torch.Generator().manual_seed(0)
    actions = policy.antithetic_actions(mean, (0, 0), generator)
    errors, counts = (torch.rand(actions.shape, generator=generator) for _ in range(2))
    return RolloutBatch(actions, errors, counts, (0, 0), multiplicative=True)


def test_where_no_action_is_better_the_mean_action_is_pulled_to_the_middle():
    mean, policy = torch.tensor([0.5, -0.25]).view(2, 1, 1, 1).expand(-1, 1, 16, 16), BLOCKS
    batch = random_batch(mean, policy)._replace(errors=torch.ones(4, 2, 1, 16, 16))
    loss = policy.loss(mean, batch._replace(counts=batch.errors))
    assert float(loss) == pytest.approx((0.5**2 + 0.25**2) / 2)


def test_no_gradient_changes_all_actions_of_an_image_alike():
    mean = torch.zeros(2, 1, 16, 16, requires_grad=True)  # without drift
    BLOCKS.loss(mean, random_batch(mean, BLOCKS)).backward()
    common, total = mean.grad.sum((1, 2, 3)).abs(), mean.grad.abs().sum((1, 2, 3))
    assert (common < 1e-5 * total).all()


def test_blocks_of_noisy_pixels_get_more_samples_where_single_pixels_say_nothing():
    """A quarter of the image is four times as noisy, but every error is spread over 9x9 pixels."""
    generator = torch.Generator().manual_seed(0)
    policy, spread = BlockPolicyGradient(), torch.nn.AvgPool2d(9, 1, 4, count_include_pad=False)
    sigma = torch.ones(1, 1, 48, 48)
    sigma[..., 24:, 24:] = 4.0
    free = torch.zeros_like(sigma, requires_grad=True)
    optimizer = torch.optim.Adam([free], 0.03)
    nothing, cost = torch.zeros(1, 1, 48, 48, dtype=torch.int64), 2 * 48 * 48
    for step in range(150):
        mean, corner = torch.tanh(free), policy.draw_corner(generator)
        actions = policy.antithetic_actions(mean, corner, generator)
        counts = torch.stack(
            [allocate_counts(toy_density(a), cost, nothing, 8, (step,)) for a in actions]
        )
        errors = spread((sigma.square() / (counts + 0.5)).flatten(0, 1)).unflatten(0, (-1, 1))
        optimizer.zero_grad()
        policy.loss(mean, RolloutBatch(actions, errors, counts.float(), corner)).backward()
        optimizer.step()
    action = torch.tanh(free.detach())
    assert action[..., 28:, 28:].mean() > 0.5
    assert action[..., :20, :20].mean() < 0


@pytest.mark.parametrize("corner", [(0, 0), (3, 5), (7, 1)])
def test_a_block_is_summed_with_the_available_margin_around_it(corner):
    """Also above and to the left of the first whole block."""
    policy = BlockPolicyGradient(block=8, margin=4)
    values = torch.rand(2, 1, 1, 37, 45, generator=torch.Generator().manual_seed(0))
    sums = policy._block_sums(values, corner, policy.margin)
    is_whole = policy.find_whole(values, corner)
    assert is_whole.sum() == (37 - corner[0]) // 8 * ((45 - corner[1]) // 8)
    assert not sums[..., ~is_whole].any()
    for i, j in is_whole.nonzero().tolist():
        top, left = corner[0] + 8 * i, corner[1] + 8 * j
        around = values[..., max(top - 4, 0) : top + 12, max(left - 4, 0) : left + 12]
        torch.testing.assert_close(sums[..., i, j], around.sum((-1, -2)))


def test_trainings_of_other_lengths_are_not_added_to_a_table(tmp_path):
    table = tmp_path / TABLE
    compare_learners.compare(table, 16, 16, [0], ["surrogate"], ["direct"])
    with pytest.raises(ValueError, match=r"--frames 64 --side 16:.*--frames 16 --side 16.*--out"):
        compare_learners.compare(table, 64, 16, [0], ["surrogate"], ["direct"])


def test_a_table_is_continued(tmp_path):
    table = tmp_path / TABLE
    before = "reinforce,direct,0,16,64,64,0.1,0.5000"
    table.write_text(f"learner,mode,seed,side,of,frames,seconds,score\n{before}\n")
    compare_learners.compare(table, 64, 16, [0], ["reinforce", "true gradient"], ["direct"])
    rows = table.read_text().splitlines()[1:]
    assert rows[0] == before  # not run again
    assert {row.partition(",")[0] for row in rows[1:]} == {"true gradient"}
