"""Rows from images: missing values, and images that are not scored."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import pytest
import torch

from rlbench import registry
from rlbench.benchmark.results import Row
from rlbench.benchmark.scoring import refusal_row, score_frame
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.clips.stored import read_header
from rlbench.frames import Size
from rlbench.run import run_clip

TEMPLATE = Row("r", "mean", "noise", "noise", 2.0, 1.5, -1, "", math.nan)


@dataclass(frozen=True)
class Bright:
    """A metric of the image's mean, or of the halves of the reference."""

    name: str = "bright"
    unit: str = ""
    direction: str = "higher"
    convention: str = "mean of all channels"
    temporal: bool = False
    needs_reference_halves: bool = False

    def at(self, height, width):
        return self

    def score(self, image, a, b):
        return image.flatten(1).mean(1)


@pytest.fixture
def frames():
    method = registry.load_method("mean")
    return list(run_clip(method, procedural_clip(3, Size(1, 16, 16), 2, 4), 2.0))


def test_a_score_has_the_samples_of_its_frame(frames, clip_folder):
    header = read_header(clip_folder)
    (row,) = score_frame(TEMPLATE, [Bright()], frames[1], frames[0], header)
    assert row.value == float(frames[1].image.mean())
    assert (row.frame, row.mean_spp, row.direction) == (1, 2.0, "higher")


def test_a_temporal_metric_has_no_score_of_the_first_frame(frames, clip_folder):
    metrics, header = [Bright(temporal=True)], read_header(clip_folder)
    assert not list(score_frame(TEMPLATE, metrics, frames[0], None, header))
    assert len(list(score_frame(TEMPLATE, metrics, frames[1], frames[0], header))) == 1


def test_an_infinite_score_is_nan_with_a_note(frames, clip_folder):
    result = replace(frames[0], image=torch.full_like(frames[0].image, torch.inf))
    (row,) = score_frame(TEMPLATE, [Bright()], result, None, read_header(clip_folder))
    assert math.isnan(row.value)
    assert row.note == "the value is inf"


def test_a_skipped_cell_has_a_reason_and_no_value():
    row = refusal_row(TEMPLATE, "needs CUDA")
    assert (row.metric, math.isnan(row.value), row.note) == ("psnr", True, "needs CUDA")


def test_repaired_pixels_are_counted_in_a_row(frames, clip_folder):
    result = replace(frames[1], repairs={"depth": 2, "radiance": 1})
    *_, row = score_frame(TEMPLATE, [Bright()], result, frames[0], read_header(clip_folder))
    assert (row.metric, row.value) == ("repaired", 3.0)
    assert row.convention.endswith("depth 2, radiance 1")
