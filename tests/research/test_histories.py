"""Each variant of histories starts as the row it extends, learns in all weights, and is small."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from baselines.accumulate import method as accumulate
from baselines.oidn.method import to_signed_radiance
from research import histories
from rlbench.checks.stress.long_runs import count_state_bytes
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip

CPU, SIZE = torch.device("cpu"), Size(1, 64, 64)


@pytest.mark.parametrize("variant", histories.VARIANTS)
def test_a_variant_starts_as_the_row_and_learns_in_all_weights(variant):
    task, clip = histories.training_task(variant, CPU, 0), procedural_clip(size=SIZE, frames=4)
    expected = replace(accumulate.build("tuned", CPU, None), decode=to_signed_radiance)
    pairs = zip(run_clip(task.method, clip, 1.0), run_clip(expected, clip, 1.0), strict=True)
    for found, row in pairs:
        difference = (found.image - row.image).abs()
        if task.method.config.two:  # half precision: a density may round to another count
            same = (found.samples.counts == row.samples.counts).float().mean()
            assert same > 0.97
            assert difference.mean() < 3e-3  # of another count, which stays in the history
        else:
            assert difference.max() < 1e-3  # a kernel keeps 1.5e-4 outside its middle
    sum(task.losses(clip, 1.0)).backward()
    idle = [n for n, p in task.networks.named_parameters() if p.grad is None or not p.grad.any()]
    assert not idle


@pytest.mark.parametrize("variant", histories.VARIANTS)
def test_a_variant_keeps_its_budget(variant):
    method = histories.build(variant, CPU, "random")
    with FlopCounterMode(display=False) as counter:
        result = next(run_clip(method, procedural_clip(size=SIZE, frames=1), 1.0))
    pixels = SIZE.h * SIZE.w
    macs, state = counter.get_total_flops() / 2 / pixels, count_state_bytes(result.state) / pixels
    assert macs <= 115_000
    assert state <= 64 + 0.1  # the change, one value of an image
