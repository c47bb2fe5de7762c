"""Half precision is another row: near the same image, faster, and only where there are networks."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from rlbench import registry
from rlbench.benchmark import results
from rlbench.benchmark.runner import RunSummary, measure
from rlbench.cli import console
from rlbench.clips.procedural.clip import procedural
from rlbench.frames import Size
from rlbench.ops.memory_format import to_channels_last, to_contiguous_float32
from rlbench.ops.unet import SMALL, UNet
from rlbench.run import run_clip
from rlbench.wrappers import HalfPrecision
from tests.benchmark.test_runner import request

CPU = torch.device("cpu")


def test_images_are_nearly_the_same_and_in_single_precision():
    method = registry.method("oidn", CPU, "random")
    clip = procedural(3, Size(1, 32, 48), 2, 8)
    full, half = (
        [s.image for s in run_clip(m, clip, 4.0)] for m in (method, HalfPrecision(method, CPU))
    )
    for one, other in zip(full, half, strict=True):
        assert other.dtype == torch.float32
        assert not torch.equal(one, other)  # else nothing was rounded
        # 16 layers that each round values and weights by 2^-9 of themselves at most
        apart = (one - other).square().mean().sqrt() / one.square().mean().sqrt()
        assert apart < 32 * 2**-9


def test_rows_in_half_precision_stand_beside_the_others(clip_folder, tmp_path):
    asked = request(clip_folder, "ours/A2", "mean", frames=1)
    measure(asked, tmp_path / "r")
    halved = dataclasses.replace(asked, half=True)
    assert measure(halved, tmp_path / "r") == RunSummary(
        measured=1, cached=1
    )  # `mean` has no networks
    rows = results.read(tmp_path / "r").groupby("method")["dtype"].unique().explode()
    assert dict(rows) == {"ours/A2": "float32", "ours/A2@half": "bfloat16", "mean": "float32"}
    measure(dataclasses.replace(halved, called="seed0"), tmp_path / "r")
    assert "ours/A2@half-seed0" in set(results.read(tmp_path / "r")["method"])


def test_what_run_prints_of_half_precision_is_of_half_precision(clip_folder, tmp_path, capsys):
    asked = dataclasses.replace(
        request(clip_folder, "ours/A2", weights="random", frames=1), half=True
    )
    measure(asked, tmp_path / "r")
    console.table(asked, tmp_path / "r")
    assert "ours/A2@half" in capsys.readouterr().out


@pytest.mark.parametrize("shape", [(2, 5, 16, 32), (1, 5, 16, 32), (1, 5, 32, 16)])
def test_packing_changes_no_value_of_a_convolution(shape):
    x = torch.rand(shape, generator=torch.Generator().manual_seed(1))
    assert to_channels_last(x).shape == x.shape
    assert torch.equal(to_channels_last(x), x)
    assert to_channels_last(x).is_contiguous(memory_format=torch.channels_last)
    assert torch.equal(to_contiguous_float32(to_channels_last(x)), x)
    assert to_contiguous_float32(to_channels_last(x)).is_contiguous()
    with torch.autocast("cpu", torch.bfloat16):
        assert to_channels_last(x).dtype == torch.bfloat16
        net = UNet(5, widths=SMALL)
        assert torch.equal(net(x), net(to_channels_last(x)))
