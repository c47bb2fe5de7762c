"""A real run on a small procedural clip, as a display shows it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import rlbench
from rlbench.benchmark.cell_images import list_images
from rlbench.benchmark.clip_sources import open_source
from rlbench.benchmark.results import read
from rlbench.benchmark.shown_clips import ShownClip, at_budget, find_shown_clips
from tests.procedural_folder import write_world

SIDE, FRAMES = 32, 4
METHODS = ("mean", "eaw")


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory) -> Path:
    """A folder with the clip `alpha` and, with images, `results` of mean and eaw at 1 spp."""
    folder = tmp_path_factory.mktemp("video")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(folder / "cache"))
        clip = write_world(folder / "alpha", side=SIDE, frames=FRAMES)
        options = {"spp": [1], "clips": [clip], "keep_images": True, "times": "none"}
        rlbench.run(METHODS, **options, out=folder / "results")
    return folder


@pytest.fixture(scope="session")
def clip(run_folder) -> ShownClip:
    """The run with its reference."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(run_folder / "cache"))
        source = open_source(run_folder / "alpha", "stored")
        (shown,) = find_shown_clips(run_folder / "results", [source], METHODS, [1.0], buffers=())
    return at_budget(shown, METHODS, 1.0, read(run_folder / "results"))


@pytest.fixture(scope="session")
def expected(run_folder) -> Callable[[str, int], np.ndarray]:
    """The display values of a kept image, by the formula of IEC 61966-2-1 in float64: [h w 3]."""
    kept = {each.cell.key.method: each for each in list_images(run_folder / "results")}

    def display(method: str, frame: int) -> np.ndarray:
        linear = kept[method].frame(frame).image.astype(np.float64).clip(0, 1).transpose(1, 2, 0)
        curved = 1.055 * linear ** (1 / 2.4) - 0.055
        return 255 * np.where(linear <= 0.0031308, 12.92 * linear, curved)

    return display
