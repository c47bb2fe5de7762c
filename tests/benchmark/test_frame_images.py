"""Images of one frame: what the files hold, and that no NaN is hidden."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from matplotlib.image import imread

from metrics.display import encode_display
from rlbench import registry
from rlbench.benchmark import results
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.frame_images import (
    NONFINITE_COLOUR,
    ImagesError,
    frame_at,
    method_image,
    write_images,
)
from rlbench.benchmark.run_plan import RunPlan
from rlbench.clips.exr import read_exr
from rlbench.clips.stored import open_clip
from rlbench.run import run_clip
from tests.conftest import write_noise, write_plugin
from tests.measuring import measure_scores


def plan(folder, *methods, spp=(1.0,)):
    return RunPlan(methods, (StoredSource(folder),), spp)


def frame_of_mean(folder, frame):
    return frame_at(run_clip(registry.load_method("mean"), open_clip(folder), 1.0), frame)


def test_the_files_of_a_method_are_its_image(clip_folder, tmp_path):
    (sheet,) = write_images(plan(clip_folder, "mean"), 1, tmp_path)
    assert sheet.file == tmp_path / "noise-1spp-01.png"
    assert imread(sheet.file).std() > 0
    result = frame_of_mean(clip_folder, 1)
    for name, image in (("mean", result.image), ("reference", result.frame.reference.mean)):
        h, w = image.shape[-2:]
        stored = read_exr(tmp_path / "noise-1spp-01" / f"{name}.exr", "RGB", h, w)
        assert np.array_equal(stored, image[0].numpy())
        drawn = 255 * imread(tmp_path / "noise-1spp-01" / f"{name}.png")[..., :3]
        expected = 255 * encode_display(image[0]).movedim(0, -1).numpy()
        assert np.abs(drawn - expected).max() <= 0.501  # 8 bits


def test_the_score_on_a_sheet_is_that_of_the_results(clip_folder, tmp_path):
    measure_scores(plan(clip_folder, "mean"), tmp_path)
    rows = results.read(tmp_path)
    score = rows[(rows["metric"] == "psnr") & (rows["frame"] == 2)]["value"].item()
    result = frame_of_mean(clip_folder, 2)
    assert method_image("mean", result).psnr == pytest.approx(score, abs=1e-9)


def test_a_budget_and_a_clip_have_a_sheet_each_by_default_of_the_last_frame(tmp_path):
    clips = tuple(StoredSource(write_noise(tmp_path / name)) for name in ("attic", "foyer"))
    sheets = list(write_images(RunPlan(("mean", "eaw"), clips, (0.5, 2.0)), -1, tmp_path / "o"))
    names = [f"{clip}-{spp}spp-02.png" for clip in ("attic", "foyer") for spp in (0.5, 2)]
    assert [sheet.file.name for sheet in sheets] == names
    images = list((tmp_path / "o").glob("*/*.exr"))
    assert len(images) == 2 * 2 + 2 * 3  # eaw takes no half samples; the reference is there, too


def test_pixels_that_are_not_finite_are_magenta_and_counted(clip_folder, tmp_path):
    result = frame_of_mean(clip_folder, 0)
    image = result.image.clone()
    image[0, 1, 3, 4], image[0, 2, 5, 6] = torch.nan, torch.inf
    pictured = method_image("mean", replace(result, image=image)).image
    assert pictured.nonfinite_pixels == 2
    magenta = (pictured.rgb8 == NONFINITE_COLOUR).all(-1)
    assert np.argwhere(magenta).tolist() == [[3, 4], [5, 6]]


def test_a_method_that_cannot_run_is_left_out_and_alone_it_has_no_sheet(clip_folder, tmp_path):
    both = plan(clip_folder, "eaw", "mean", spp=(0.5,))
    (sheet,) = write_images(both, 0, tmp_path)
    assert list(sheet.missing) == ["eaw"]
    assert re.search("1 to 8 spp.*0.5", sheet.missing["eaw"])
    assert {file.name for file in tmp_path.glob("*/*.png")} == {"mean.png", "reference.png"}
    (alone,) = write_images(plan(clip_folder, "eaw", spp=(0.5,)), 0, tmp_path / "alone")
    assert (alone.drawn, alone.failed) == ((), frozenset())
    assert not alone.file.exists()


def test_a_method_that_raises_is_reported_and_the_others_are_drawn(clip_folder, tmp_path):
    registry.use_plugin(
        write_plugin(tmp_path / "odd.py", "odd", body="raise ValueError('no luck')")
    )
    (sheet,) = write_images(plan(clip_folder, "odd", "mean"), 0, tmp_path)
    assert (sheet.drawn, sheet.failed) == (("mean",), {"odd"})
    assert re.fullmatch(r"ValueError: no luck \(odd\.py:\d+\)", sheet.missing["odd"])


@pytest.mark.parametrize("frame", [3, -4])
def test_a_missing_frame_is_an_error(clip_folder, tmp_path, frame):
    with pytest.raises(ImagesError, match=f"--frame {frame}: clip 'noise' has frames 0 to 2"):
        list(write_images(plan(clip_folder, "mean"), frame, tmp_path))


def test_a_sheet_has_rows_of_sample_counts_and_of_differences_to_the_best(clip_folder, tmp_path):
    body = "return samples.mean, None"
    plugin = write_plugin(tmp_path / "left.py", "left", traits="adaptive=True", body=body)
    code = plugin.read_text().replace(
        "return torch.ones_like(samples.counts, dtype=torch.float32)",
        "return (torch.arange(samples.counts.shape[-1]) < 4).float().expand(samples.counts.shape)",
    )
    plugin.write_text(code)
    registry.use_plugin(plugin)
    plain, adaptive, two = (
        imread(next(write_images(plan(clip_folder, *names), 0, tmp_path / names[0])).file)
        for names in (("mean",), ("left",), ("eaw", "mean"))
    )
    assert adaptive.shape[0] > plain.shape[0]
    assert two.shape[0] > 1.3 * plain.shape[0]
