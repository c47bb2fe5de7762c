"""Broken toy methods, written as plugin files, and the stressed method of one."""

from __future__ import annotations

from pathlib import Path

import torch

from rlbench import registry
from rlbench.checks.stress.methods import load_stressed_method
from rlbench.checks.stress.section import StressedMethod
from tests.conftest import write_plugin

__all__ = ["stressed_toy"]

CPU = torch.device("cpu")


def stressed_toy(folder: Path, body: str = "", traits: str = "", plan: str = "") -> StressedMethod:
    """A method `toy` that averages its samples, or whose denoiser runs `body`."""
    file = write_plugin(folder / "toy.py", "toy", traits=traits, **({"body": body} if body else {}))
    if plan:
        uniform = "return torch.ones_like(samples.counts, dtype=torch.float32)"
        file.write_text(file.read_text().replace(uniform, plan))
    registry.use_plugin(file)
    return load_stressed_method("toy", CPU)
