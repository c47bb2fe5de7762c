"""Kept images of a real run: of two methods that sample uniformly, and an adaptive one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from rlbench.benchmark.results import read
from rlbench.benchmark.shown_clips import ShownClip
from rlbench.cli.selection import find_images
from tests.reports.kept_run import run_with_images

METHODS = ("accumulate/contrast", "eaw", "mean")
CUT = 2


@dataclass(frozen=True)
class Kept:
    """The rows of the run, and its clips with their images at 1 spp."""

    rows: Any
    clips: list[ShownClip]
    folder: Any

    def psnr(self, method: str, clip: str, frame: int) -> float:
        """The score that the run stored."""
        rows = self.rows[(self.rows["metric"] == "psnr") & (self.rows["frame"] == frame)]
        own = rows[(rows["method"] == method) & (rows["clip"] == clip)]
        return float(own["value"].iloc[0])


@pytest.fixture(scope="session")
def kept(tmp_path_factory) -> Kept:
    folder = tmp_path_factory.mktemp("kept")
    run_with_images(folder, METHODS, [1], CUT, times="none")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(folder / "cache"))
        rows = read(folder / "results")
        clips = list(find_images(folder / "results", rows, [folder / "clips"])[0])
    return Kept(rows, clips, folder)
