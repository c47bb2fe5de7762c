"""Rejection of history: how far it is kept, given the radiance of the current frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from methods.ours.state import ReprojectedHistory
from rlbench.ops.accumulation import AccumulatedRadiance
from rlbench.ops.antilag import history_confidence

__all__ = ["AntiLag", "HistoryRejection", "KeepHistory"]


class HistoryRejection(Protocol):
    """Decides how far the history is kept, given the radiance of the current frame."""

    def apply(
        self, history: ReprojectedHistory, current: AccumulatedRadiance
    ) -> ReprojectedHistory:
        """The history, with less weight where it is rejected."""


@dataclass(frozen=True)
class KeepHistory:
    """Rejects nothing."""

    def apply(
        self, history: ReprojectedHistory, current: AccumulatedRadiance
    ) -> ReprojectedHistory:
        """The history, unchanged."""
        return history


@dataclass(frozen=True)
class AntiLag:
    """Rejects history by `history_confidence`."""

    def apply(
        self, history: ReprojectedHistory, current: AccumulatedRadiance
    ) -> ReprojectedHistory:
        """The history, its weight and similarity multiplied by the confidence."""
        confidence = history_confidence(history.radiance, current, history.image)
        return history.with_confidence(confidence)
