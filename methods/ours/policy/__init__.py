"""How the sampler learns: learners behind one interface, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from methods.ours.policy.critic import CriticLearner, make_critic_learner
from methods.ours.policy.learner import AllocationProblem, Env, Rollout, SamplerLearner, StepResult
from methods.ours.policy.reinforce import BlockPolicyGradient, BlockReinforce, RolloutBatch
from methods.ours.policy.sample_gradients import (
    CombinedLearner,
    SurrogateLearner,
    gamma_gradient_per_sample,
)
from methods.ours.policy.stochastic_rounding import StochasticLearner
from rlbench.errors import RlbenchError

__all__ = [
    "APPO",
    "LEARNERS",
    "RLLIB_APPO",
    "AllocationProblem",
    "BlockPolicyGradient",
    "BlockReinforce",
    "CombinedLearner",
    "CriticLearner",
    "Env",
    "LearnerError",
    "Rollout",
    "RolloutBatch",
    "SamplerLearner",
    "StepResult",
    "StochasticLearner",
    "SurrogateLearner",
    "gamma_gradient_per_sample",
    "make_learner",
]

LEARNERS: Mapping[str, Callable[[int], SamplerLearner]] = {  # by channels of the observation
    "reinforce": lambda channels: BlockReinforce(),
    "reinforce+surrogate": lambda channels: CombinedLearner(),
    "critic": make_critic_learner,
    "surrogate": lambda channels: SurrogateLearner(),
    "gamma": lambda channels: SurrogateLearner(gamma_gradient_per_sample),
    "stochastic": lambda channels: StochasticLearner(),
}
APPO = "appo"  # learns from episodes, see `one_policy_task` in methods.ours.train
RLLIB_APPO = "rllib-appo"  # trains by its own loop, see methods.ours.policy.appo


class LearnerError(RlbenchError, LookupError):
    """An unknown learner, or one that has no loss of its own."""


def make_learner(name: str, channels: int) -> SamplerLearner:
    """The learner of a name, for a sampler with observations of `channels`.

    Raises LearnerError for an unknown name, and for `appo` and `rllib-appo`.

    >>> make_learner("surrogate", 39).min_samples
    1
    """
    if name == RLLIB_APPO:
        raise LearnerError(
            f"'{name}' trains by a loop of its own around an environment: call "
            "methods.ours.policy.appo.train"
        )
    if name == APPO:
        raise LearnerError(
            f"'{name}' learns from episodes, not from single frames: train ours/paper-appo"
        )
    if name not in LEARNERS:
        raise LearnerError(f"'{name}' is not a learner; choose one of: {', '.join(LEARNERS)}")
    return LEARNERS[name](channels)
