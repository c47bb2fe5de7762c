"""How the sampler learns: policy optimisers behind one interface, by the names of their rows."""

from __future__ import annotations

from collections.abc import Callable

from methods.ours.policy import critic
from methods.ours.policy import gamma_gradient as gamma
from methods.ours.policy.block_policy_gradient import Draws, Policy
from methods.ours.policy.block_reinforce import PpoPixel
from methods.ours.policy.combined import Both
from methods.ours.policy.interface import Learner, Situation, Trial
from methods.ours.policy.surrogate_gradient import Surrogate

__all__ = ["LEARNERS", "Both", "Draws", "Learner", "Policy", "Situation", "Trial", "learner"]

LEARNERS: dict[str, Callable[[int], Learner]] = {  # made for a number of channels seen
    "ppo-pixel": lambda channels: PpoPixel(),
    "ppo-pixel+surrogate": lambda channels: Both(),
    "critic": critic.learner,
    "surrogate": lambda channels: Surrogate(),
    "gamma": lambda channels: gamma.learner(),
}
RLLIB = "rllib-appo"  # has a loop of its own, see methods.ours.policy.appo


def learner(name: str, channels: int) -> Learner:
    """The learner of a name, for a sampler that sees `channels`; raises LookupError."""
    if name in LEARNERS:
        return LEARNERS[name](channels)
    told = f"'{name}' is no way to train a sampler; there is: {', '.join(LEARNERS)}"
    if name == RLLIB:
        told = f"'{RLLIB}' runs its own loop around an environment: methods.ours.policy.appo.train"
    raise LookupError(told)
