"""A blend that is learned alone starts as the rule, and is scored as the whole method is."""

from __future__ import annotations

from dataclasses import fields

import pytest
import torch

from baselines.accumulate.method import Accumulate
from metrics.psnr import decibels
from research import learned_blend
from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.run import run_clip
from tests.procedural_folder import write_world


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return write_world(tmp_path_factory.mktemp("blend") / "world", frames=4)


@pytest.fixture(scope="module")
def frames(world):
    rule = registry.load_method(learned_blend.RULE)
    recorder = learned_blend.Recorder(**{f.name: getattr(rule, f.name) for f in fields(Accumulate)})
    return learned_blend.record_clip(recorder, world, 1.0)


def test_the_rule_on_recorded_frames_scores_what_the_method_scores(world, frames):
    rule, psnr = registry.load_method(learned_blend.RULE), registry.load_plugin("metrics", "psnr")
    expected = []
    for result in run_clip(rule, open_clip(world, rule.traits.inputs), 1.0):
        halves = result.frame.reference
        expected += psnr.score(psnr.compare(result.image, halves.half_a, halves.half_b)).tolist()
    weights = learned_blend.blend_frames(frames, lambda _, worth: torch.full_like(worth, 0.3))
    # the rule also moves the last image between log transfer and radiance: a rounding
    assert decibels(torch.stack(weights)).tolist() == pytest.approx(expected, abs=1e-2)


def test_an_untrained_network_is_the_rule_and_training_lowers_the_error(frames):
    def error(network):
        blended = learned_blend.blend_frames(frames, learned_blend._learned(network))
        return torch.stack(blended)[1:].log().mean().item()

    untrained = learned_blend.BlendNetwork()
    rule = learned_blend.blend_frames(frames, lambda _, worth: torch.full_like(worth, 0.3))
    assert error(untrained) == pytest.approx(float(torch.stack(rule)[1:].log().mean()), abs=1e-4)
    assert error(learned_blend.train_blend([frames], epochs=30)) < error(untrained)
