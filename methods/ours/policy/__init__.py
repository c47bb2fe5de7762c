"""How the sampler learns: policy optimisers behind one interface, by the names of their rows."""

from __future__ import annotations

from collections.abc import Callable

from methods.ours.policy import critic, gamma_gradient
from methods.ours.policy.block_policy_gradient import BlockPolicyGradient, RolloutBatch
from methods.ours.policy.block_reinforce import BlockReinforce
from methods.ours.policy.combined import CombinedLearner
from methods.ours.policy.interface import AllocationProblem, Rollout, SamplerLearner
from methods.ours.policy.surrogate_gradient import SurrogateLearner

__all__ = [
    "LEARNERS",
    "CombinedLearner",
    "RolloutBatch",
    "SamplerLearner",
    "BlockPolicyGradient",
    "AllocationProblem",
    "Rollout",
    "learner",
]

LEARNERS: dict[str, Callable[[int], SamplerLearner]] = {  # made for a number of channels seen
    "ppo-pixel": lambda channels: BlockReinforce(),
    "ppo-pixel+surrogate": lambda channels: CombinedLearner(),
    "critic": critic.learner,
    "surrogate": lambda channels: SurrogateLearner(),
    "gamma": lambda channels: gamma_gradient.learner(),
}
RLLIB = "rllib-appo"  # has a loop of its own, see methods.ours.policy.appo


def learner(name: str, channels: int) -> SamplerLearner:
    """The learner of a name, for a sampler that sees `channels`; raises LookupError."""
    if name in LEARNERS:
        return LEARNERS[name](channels)
    told = f"'{name}' is no way to train a sampler; there is: {', '.join(LEARNERS)}"
    if name == RLLIB:
        told = f"'{RLLIB}' runs its own loop around an environment: methods.ours.policy.appo.train"
    raise LookupError(told)
