"""Speed of our U-Net beside Intel's library with the same weights: pytest --benchmark-only."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from baselines.oidn import method, tza
from rlbench.clips.procedural.clip import procedural
from rlbench.frames import Size
from rlbench.run import run_clip

WEIGHTS = Path(tza.__file__).parent / "cards" / "oidn.safetensors"
SIZE = Size(1, 720, 720)


@pytest.mark.parametrize("name", ["rlbench", "intel"])
@pytest.mark.benchmark(group="OIDN, 720x720, HDR with albedo and normal, one thread")
def test_oidn(benchmark, name):
    """Exposure, transfer, network and back; the network is the same, and so is the image."""
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.library import Filter, Settings

    made = method.build("", torch.device("cpu"), None)
    (shown,) = run_clip(made, procedural(3, SIZE, frames=1), 1.0)
    gbuffer, settings = shown.frame.gbuffer, Settings("balanced", weights=tza.export(WEIGHTS))
    intel = Filter(settings, SIZE.h, SIZE.w, torch.get_num_threads())
    seen = (shown.samples.mean[0], gbuffer.albedo[0], gbuffer.normal[0])
    runs: dict[str, Callable[[], torch.Tensor]] = {
        "rlbench": lambda: made.denoise(gbuffer, shown.samples, None)[0][0],
        "intel": lambda: intel(*seen),
    }
    with torch.inference_mode():
        image = benchmark.pedantic(runs[name], rounds=5, warmup_rounds=1)
    # 720 is a multiple of 16, so that borders are the same
    torch.testing.assert_close(image, shown.image[0], rtol=1e-3, atol=1e-4)
