"""The settings of RLlib's APPO."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AppoSettings"]


@dataclass(frozen=True)
class AppoSettings:
    """Settings of one training by APPO.

    Clip range, fragment length and gradient clipping as in the release of Scardigli et al. 2023.
    """

    joint_ratio: bool = False  # the literal recipe: one ratio for all pixels, one reward a frame
    learning_rate: float = 1e-3  # at the start; it falls linearly
    action_std: float = 0.3  # standard deviation of the action
    reach: int = 0  # pixels around one whose errors are credited to it
    price_weight: float = 1.0  # share of the price of samples that is charged
    multiplicative: bool = False  # does a step of the action multiply the density, or add to it?
    clip: float = 0.15  # of the probability ratio, around 1
    fragment_length: int = 4  # frames of an update
    env_runners: int = 0  # processes that act; 0: this one
