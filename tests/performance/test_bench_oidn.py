"""The ratios of docs/concepts/open-image-denoise.md, as its Speed section says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch.nn import functional as F

from baselines.oidn import method, tza
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.ops.upsample import UpsampleConcatConv
from rlbench.run import run_clip

WEIGHTS = Path(tza.__file__).parent / "cards" / "oidn.safetensors"
SIZE = Size(1, 720, 720)


@pytest.mark.parametrize("name", ["rlbench", "intel"])
@pytest.mark.benchmark(group="OIDN, 720x720, HDR with albedo and normal, one thread")
def test_oidn(benchmark, name):
    """Exposure, transfer function, network and their inverses; network and image are the same."""
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.method import Filter, FilterSettings

    oidn = method.build("", torch.device("cpu"), None)
    (result,) = run_clip(oidn, procedural_clip(3, SIZE, frames=1), 1.0)
    gbuffer, settings = (
        result.frame.gbuffer,
        FilterSettings("balanced", weights=tza.export(WEIGHTS)),
    )
    intel = Filter(settings, SIZE.h, SIZE.w, torch.get_num_threads())
    inputs = (result.samples.mean[0], gbuffer.albedo[0], gbuffer.normal[0])
    runs: dict[str, Callable[[], torch.Tensor]] = {
        "rlbench": lambda: oidn.denoise(gbuffer, result.samples, None)[0][0],
        "intel": lambda: intel(*inputs),
    }
    with torch.inference_mode():
        image = benchmark.pedantic(runs[name], rounds=5, warmup_rounds=1)
    # 720 is a multiple of 16, so both treat borders alike
    torch.testing.assert_close(image, result.image[0], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", ["rlbench", "torch"])
@pytest.mark.benchmark(group="upsample, concatenate, convolve, 64 + 41 -> 64 x192x192")
def test_upsample_concat_conv(benchmark, name):
    """The widest layer of the U-Net in `ours`, against the three steps in torch."""
    generator = torch.Generator().manual_seed(0)
    coarse, skip = (
        torch.randn(1, c, side, side, generator=generator).to(memory_format=torch.channels_last)
        for c, side in ((64, 96), (41, 192))
    )
    layer = (
        UpsampleConcatConv(64, 41, 64).to(memory_format=torch.channels_last).requires_grad_(False)
    )

    def three_steps() -> torch.Tensor:
        upsampled = F.interpolate(coarse, scale_factor=2.0, mode="nearest")
        return F.conv2d(torch.cat((upsampled, skip), 1), layer.weight, layer.bias, padding=1)

    runs: dict[str, Callable[[], torch.Tensor]] = {
        "rlbench": lambda: layer(coarse, skip),
        "torch": three_steps,
    }
    with torch.inference_mode():
        output = benchmark.pedantic(runs[name], rounds=20, warmup_rounds=2)
        torch.testing.assert_close(output, three_steps(), rtol=0, atol=1e-4)  # sums of 945 products
