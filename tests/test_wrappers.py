"""Wrappers: forwarding, half precision and its rows in the results, skipped tiles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch

from rlbench import registry
from rlbench.benchmark import results
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.run_outcome import read_outcome
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import RunSummary
from rlbench.cli import console
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.family import Traits
from rlbench.frames import Size
from rlbench.method import Method, config_json
from rlbench.ops.memory_format import to_channels_last, to_contiguous_float32
from rlbench.ops.unet import UNet
from rlbench.ops.unet_widths import FAST_WIDTHS
from rlbench.run import run_clip
from rlbench.wrappers import HalfPrecision, MethodWrapper
from tests.measuring import measure_scores

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Doubled(MethodWrapper[Method]):
    """A wrapper that overrides one member."""

    def denoise(self, gbuffer, samples, state):
        image, state = super().denoise(gbuffer, samples, state)
        return 2 * image, state


def test_a_wrapper_forwards_all_members_that_it_does_not_override():
    method = registry.load_method("ours/A2", CPU, "random")
    wrapper = Doubled(method)
    assert isinstance(wrapper, Method)
    assert wrapper.traits == method.traits != Traits()
    assert config_json(wrapper) == config_json(method) != "{}"
    clip = procedural_clip(3, Size(1, 32, 48), 2, 8)
    for plain, doubled in zip(
        run_clip(method, clip, 4.0), run_clip(wrapper, clip, 4.0), strict=True
    ):
        assert torch.equal(doubled.samples.counts, plain.samples.counts)
        assert torch.equal(doubled.image, 2 * plain.image)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_half_precision_images_are_float32_and_nearly_the_same(dtype):
    method = registry.load_method("oidn", CPU, "random")
    clip = procedural_clip(3, Size(1, 32, 48), 2, 8)
    full, half = (
        [result.image for result in run_clip(m, clip, 4.0)]
        for m in (method, HalfPrecision(method, CPU, dtype))
    )
    for single, reduced in zip(full, half, strict=True):
        assert reduced.dtype == torch.float32
        assert not torch.equal(single, reduced)  # else nothing was rounded
        # 16 layers, each with a relative rounding error of about eps / 4 in values and in weights
        error = (single - reduced).square().mean().sqrt() / single.square().mean().sqrt()
        assert error < 8 * torch.finfo(dtype).eps


def half_plan(folder: Path, *methods: str, half: bool = True) -> RunPlan:
    clips = (StoredSource(folder),)
    return RunPlan(methods, clips, spp=(1.0,), limit_frames=1, half=half)


@pytest.mark.usefixtures("native_bf16")
def test_half_precision_has_its_own_rows_beside_the_others(clip_folder, tmp_path, capsys):
    plan = half_plan(clip_folder, "ours/A2", "mean")
    measure_scores(replace(plan, half=False), tmp_path / "r")
    # `mean` has no networks, so its cell is cached
    assert measure_scores(plan, tmp_path / "r") == RunSummary(measured=1, cached=1)
    rows = results.read(tmp_path / "r").groupby("method")["dtype"].unique().explode()
    assert dict(rows) == {"ours/A2": "float32", "ours/A2@half": "bfloat16", "mean": "float32"}
    console.print_outcome(read_outcome(plan, RunSummary(), tmp_path / "r"))
    assert "ours/A2@half" in capsys.readouterr().out
    measure_scores(replace(plan, weights_label="seed0"), tmp_path / "r")
    assert "ours/A2@half-seed0" in set(results.read(tmp_path / "r")["method"])


@pytest.mark.parametrize("shape", [(2, 5, 16, 32), (1, 5, 16, 32), (1, 5, 32, 16)])
def test_memory_formats_change_no_value_of_a_convolution(shape):
    x = torch.rand(shape, generator=torch.Generator().manual_seed(1))
    assert to_channels_last(x).shape == x.shape
    assert torch.equal(to_channels_last(x), x)
    assert to_channels_last(x).is_contiguous(memory_format=torch.channels_last)
    assert torch.equal(to_contiguous_float32(to_channels_last(x)), x)
    assert to_contiguous_float32(to_channels_last(x)).is_contiguous()
    with torch.autocast("cpu", torch.bfloat16):
        assert to_channels_last(x).dtype == torch.bfloat16
        net = UNet(5, widths=FAST_WIDTHS)
        assert torch.equal(net(x), net(to_channels_last(x)))
