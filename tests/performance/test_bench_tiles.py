"""Skipped tiles at 720 x 1280 on a still camera against the method: pytest --benchmark-only."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import pytest
import torch

from baselines.eaw.still import Still
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.method import Method
from rlbench.run import run_clip
from rlbench.sanitize import sanitize_frame
from rlbench.wrappers import SkipTiles

SIZE, FRAMES, SPP = Size(1, 720, 1280), 6, 0.25
WARM_UP = 3  # frames until still tiles are skipped


@pytest.mark.parametrize("static", [True, False], ids=["static", "moving objects"])
@pytest.mark.parametrize("name", ["method", "tiles"])
@pytest.mark.benchmark(group="denoise at 0.25 spp, still camera, 1280x720")
def test_denoise(benchmark: Any, name: str, static: bool) -> None:
    method: Method = SkipTiles(Still()) if name == "tiles" else Still()
    clip = procedural_clip(3, SIZE, FRAMES, 8, static=static, still_camera=True)
    results = list(run_clip(method, clip, SPP))
    calls = []
    for before, after in zip(results[WARM_UP - 1 :], results[WARM_UP:], strict=False):
        gbuffer, *_ = sanitize_frame(after.frame, method.traits.inputs)
        calls.append((gbuffer, after.samples, before.state))
    turns = cycle(calls)
    with torch.inference_mode():
        benchmark(lambda: method.denoise(*next(turns)))
