"""Training of learned methods: the same loop, clips and schedule for every method.

A learned method provides a `TrainingTask` (see `rlbench.training.task` for a guide with an
example). `train` trains the method and writes its weights. The names below are imported on first
use, so that importing this package does not import torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

__all__ = [
    "BUDGETS_FROM_1_SPP",
    "Progress",
    "SampleGradient",
    "SurrogateGradient",
    "TrainingConfig",
    "TrainingError",
    "TrainingResult",
    "TrainingTask",
    "kuznetsov_gradient",
    "relaxed_counts",
    "train",
]

if TYPE_CHECKING:
    from rlbench.training.checkpoint import Progress
    from rlbench.training.loop import TrainingResult, train
    from rlbench.training.surrogate_gradient import (
        SampleGradient,
        SurrogateGradient,
        kuznetsov_gradient,
        relaxed_counts,
    )
    from rlbench.training.task import (
        BUDGETS_FROM_1_SPP,
        TrainingConfig,
        TrainingError,
        TrainingTask,
    )
else:
    import lazy_loader

    __getattr__, __dir__, _ = lazy_loader.attach(
        __name__,
        submod_attrs={
            "checkpoint": ["Progress"],
            "loop": ["TrainingResult", "train"],
            "surrogate_gradient": [
                "SampleGradient",
                "SurrogateGradient",
                "kuznetsov_gradient",
                "relaxed_counts",
            ],
            "task": ["BUDGETS_FROM_1_SPP", "TrainingConfig", "TrainingError", "TrainingTask"],
        },
    )
