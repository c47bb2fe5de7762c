"""What a page shows of a clip is what the run kept and what the clip holds."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from rlbench.benchmark.cell_images import KeptImagesError, list_images
from rlbench.benchmark.runner import measure
from rlbench.benchmark.shown_clips import find_shown_clips
from rlbench.clips.stored import open_clip
from tests.benchmark.test_runner import run_plan
from tests.conftest import write_noise


@pytest.fixture
def plan(clip_folder, tmp_path):
    plan = run_plan(clip_folder, spp=(1.0, 2.0), seeds=(0, 1))
    measure(plan, tmp_path / "r", keep_images=True)
    return plan


def test_images_reference_and_buffers_are_those_on_disk(plan, tmp_path):
    (shown,) = find_shown_clips(tmp_path / "r", plan.clips, ["mean"], [2.0])
    clip = open_clip(plan.clips[0].folder)
    (images,) = shown.images  # of the first seed
    kept = next(
        each
        for each in list_images(tmp_path / "r")
        if (each.cell.key.target_spp, each.cell.key.seed) == (2.0, 0)
    )
    assert (shown.name, images.method, images.target_spp) == (clip.name, "mean", 2.0)
    assert list(shown.buffers) == ["albedo", "normal", "depth", "motion"]
    for index, frame in enumerate(clip):
        assert np.array_equal(images.frames[index], kept.frame(index).image)
        assert np.array_equal(images.counts[index], kept.frame(index).counts)
        assert np.array_equal(shown.reference[index], frame.reference.mean[0])
        assert torch.equal(torch.from_numpy(shown.buffers["depth"][index]), frame.gbuffer.depth[0])


def test_a_clip_that_has_changed_is_an_error(plan, tmp_path):
    write_noise(plan.clips[0].folder, exposure=2.0)
    changed = run_plan(plan.clips[0].folder).clips
    with pytest.raises(KeptImagesError, match="show a clip with digest"):
        find_shown_clips(tmp_path / "r", changed, ["mean"], [1.0])


def test_only_the_buffers_that_are_named_are_read(plan, tmp_path):
    (shown,) = find_shown_clips(tmp_path / "r", plan.clips, ["mean"], [2.0], buffers=["depth"])
    assert list(shown.buffers) == ["depth"]
