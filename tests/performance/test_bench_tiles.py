"""Skipped tiles: prints the table of docs/concepts/skipping.md, one row per clip."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from baselines.eaw.method import Still
from rlbench import registry
from rlbench.checks.frame_edits import to_clip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.method import Method
from rlbench.run import FrameResult, run_clip
from rlbench.wrappers import MethodWrapper, SkipTiles

FRAMES, SPP, WARM_UP = 9, 0.25, 3  # tiles are skipped from the third frame on
SIZES = {"1280x720": Size(1, 720, 1280), "640x360": Size(1, 360, 640)}
CLIPS = {"nothing moves": True, "three objects move": False}
COLUMNS = (
    "pixels skipped",
    "denoise, time / time without",
    "largest difference",
    "PSNR [dB]",
    "of `mean`",
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


@pytest.fixture(scope="module")
def table(request: pytest.FixtureRequest) -> Iterator[dict[str, list[str]]]:
    """Cells by clip; printed at the end."""
    rows: dict[str, list[str]] = {}
    yield rows
    lines = [
        f"| still camera, 0.25 spp | {' | '.join(COLUMNS)} |",
        f"|---|{'---:|' * len(COLUMNS)}",
    ]
    lines += [f"| {clip} | {' | '.join(cells)} |" for clip, cells in rows.items()]
    with request.config.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled():
        print("", *lines, sep="\n")  # noqa: T201


@pytest.mark.parametrize("static", CLIPS)
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.benchmark(group="a frame of eaw/still at 0.25 spp, with skipped tiles and without")
def test_skipped_tiles(benchmark: Any, table: dict[str, list[str]], size: str, static: str) -> None:
    """Frame by frame in turn, so that other load on the machine slows both."""
    clip = procedural_clip(3, SIZES[size], FRAMES, 8, static=CLIPS[static], still_camera=True)
    frames = to_clip(clip)
    methods = Timed(Still()), Timed(SkipTiles(Still()))
    pairs = zip(*(run_clip(method, frames, SPP) for method in methods), strict=True)
    kept, differences, psnr = [], [], registry.load_plugin("metrics", "psnr").score

    def run_frame() -> None:
        plain, skipping = next(pairs)
        results[:] = [plain]
        kept.append(skipping.state.skipped)
        differences.append(float((plain.image - skipping.image).abs().max()))

    results: list[FrameResult] = []
    benchmark.pedantic(run_frame, rounds=FRAMES)
    medians = [statistics.median(method.seconds[WARM_UP:]) for method in methods]
    ratio, largest = medians[1] / medians[0], max(differences)
    mean = list(run_clip(registry.load_method("mean", results[0].image.device), frames, SPP))
    scores = (
        float(psnr(r.image, r.frame.reference.half_a, r.frame.reference.half_b))
        for r in (results[-1], mean[-1])
    )
    share = f"{statistics.fmean(kept[WARM_UP:]):.0%}"
    cells = [share, f"{ratio:.2f}", f"{largest:g}", *(f"{score:.1f}" for score in scores)]
    table[f"{static}, {size}"] = cells
    assert largest == 0
