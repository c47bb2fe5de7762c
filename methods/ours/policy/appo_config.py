"""The settings of APPO."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Appo:
    """How RLlib is asked to learn.

    Clip range, length of fragments and of gradients as in the release of Scardigli et al. 2023.
    """

    joint: bool = False  # the literal recipe: one ratio for all pixels, one reward a frame
    rate: float = 1e-3  # learning rate at the start; it falls linearly
    action_std: float = 0.3  # deviation of the action
    reach: int = 0  # pixels around one whose errors are credited to it
    price_weight: float = 1.0  # share of the price of samples that is charged
    multiplicative: bool = False  # do densities grow by factors with the action, or by steps?
    clip: float = 0.15
    fragment: int = 4  # frames of an update
    runners: int = 0  # processes that act; 0: this one
