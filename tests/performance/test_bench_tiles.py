"""Skipped tiles: prints the table of docs/concepts/skipping.md, one row per clip."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, field

import pytest

from baselines.eaw.method import Still
from rlbench import registry
from rlbench.checks.frame_edits import to_clip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.method import Method
from rlbench.run import run_clip
from rlbench.wrappers import MethodWrapper, SkipTiles

FRAMES, SPP, WARM_UP = 9, 0.25, 3  # tiles are skipped from the third frame on
SIZES = {"1280x720": Size(1, 720, 1280), "640x360": Size(1, 360, 640)}
CLIPS = {"nothing moves": True, "three objects move": False}
COLUMNS = (
    *("still camera, 0.25 spp", "pixels skipped", "denoise, time / time without"),
    *("largest difference", "PSNR [dB]", "of `mean`"),
)


@dataclass(frozen=True)
class Timed(MethodWrapper[Method]):
    """The wrapped method, and the processor time of each call of `denoise`, in seconds."""

    seconds: list[float] = field(default_factory=list)

    def denoise(self, gbuffer, samples, state):
        start = time.process_time()
        result = super().denoise(gbuffer, samples, state)
        self.seconds.append(time.process_time() - start)
        return result


@pytest.mark.parametrize("static", CLIPS)
@pytest.mark.parametrize("size", SIZES)
def test_skipped_tiles(benchmark, table, size, static):
    """Frame by frame in turn, so that other load on the machine slows both."""
    clip = procedural_clip(3, SIZES[size], FRAMES, 8, static=CLIPS[static], still_camera=True)
    frames, methods = to_clip(clip), (Timed(Still()), Timed(SkipTiles(Still())))
    pairs = zip(*(run_clip(method, frames, SPP) for method in methods), strict=True)
    results, psnr = [], registry.load_plugin("metrics", "psnr")
    benchmark.pedantic(lambda: results.append(next(pairs)), rounds=FRAMES)
    medians = [statistics.median(method.seconds[WARM_UP:]) for method in methods]
    skipped = statistics.fmean(after.state.skipped for _, after in results[WARM_UP:])
    largest = max(float((plain.image - after.image).abs().max()) for plain, after in results)
    *_, mean = run_clip(registry.load_method("mean"), frames, SPP)
    scores = (
        float(psnr.score(psnr.compare(each.image, truth.half_a, truth.half_b)))
        for each, truth in ((each, each.frame.reference) for each in (results[-1][0], mean))
    )
    cells = (f"{skipped:.0%}", f"{medians[1] / medians[0]:.2f}", f"{largest:g}")
    cells = (*cells, *(f"{score:.1f}" for score in scores))
    table[f"{static}, {size}"] = dict(zip(COLUMNS[1:], cells, strict=True))
    assert largest == 0
