"""The learned correction of the density, scaled between the rule and itself."""

from __future__ import annotations

import pytest
import torch

from methods.ours.experiments.correction import ScaledAction
from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.run import run_clip


def images(method) -> list[torch.Tensor]:
    return [result.image for result in run_clip(method, procedural_clip(frames=3), spp=1.0)]


@pytest.mark.parametrize(("scale", "row"), [(0.0, "ours/by-rule"), (1.0, "ours")])
def test_the_ends_of_the_scale_are_the_rule_and_the_learned_density(scale, row):
    scaled = ScaledAction(registry.load_method("ours", torch.device("cpu")), scale)
    for one, other in zip(
        images(scaled), images(registry.load_method(row, torch.device("cpu"))), strict=True
    ):
        assert torch.equal(one, other)
