"""Pictures of one frame: what is in the files, and that nothing broken is hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from matplotlib.image import imread

from metrics.display import display as of_the_metrics
from rlbench import registry
from rlbench.benchmark import results
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.image_sheet import (
    NONFINITE_COLOUR,
    ImagesError,
    display,
    frame_at,
    picture,
    write,
)
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import measure
from rlbench.clips.exr import read_exr
from rlbench.clips.stored import open_clip
from rlbench.run import run_clip
from tests.conftest import write_noise, write_plugin


def request(folder, *methods, spp=(1.0,)):
    return RunPlan(methods, (StoredSource(folder),), spp)


def test_the_files_of_a_method_are_its_image(clip_folder, tmp_path):
    (sheet,) = write(request(clip_folder, "mean"), 1, tmp_path)
    assert sheet.file == tmp_path / "noise-1spp-01.png"
    assert imread(sheet.file).std() > 0
    shown = frame_at(run_clip(registry.method("mean"), open_clip(clip_folder), 1.0), 1)
    for name, image in (("mean", shown.image), ("reference", shown.frame.reference.mean)):
        h, w = image.shape[-2:]
        stored = read_exr(tmp_path / "noise-1spp-01" / f"{name}.exr", "RGB", h, w)
        assert np.array_equal(stored, image[0].numpy())
        drawn = 255 * imread(tmp_path / "noise-1spp-01" / f"{name}.png")[..., :3]
        wanted = 255 * of_the_metrics(image[0]).movedim(0, -1).numpy()
        assert np.abs(drawn - wanted).max() <= 0.501  # 8 bits


def test_the_score_on_a_sheet_is_that_of_the_bench(clip_folder, tmp_path):
    measure(request(clip_folder, "mean"), tmp_path)
    rows = results.read(tmp_path)
    score = rows[(rows["metric"] == "psnr") & (rows["frame"] == 2)]["value"].item()
    shown = frame_at(run_clip(registry.method("mean"), open_clip(clip_folder), 1.0), 2)
    assert picture("mean", shown).psnr == pytest.approx(score, abs=1e-9)


def test_a_budget_and_a_clip_have_a_sheet_each_by_default_of_the_last_frame(tmp_path):
    clips = tuple(StoredSource(write_noise(tmp_path / name)) for name in ("attic", "foyer"))
    sheets = list(write(RunPlan(("mean", "eaw"), clips, (0.5, 2.0)), -1, tmp_path / "o"))
    names = [f"{clip}-{spp}spp-02.png" for clip in ("attic", "foyer") for spp in (0.5, 2)]
    assert [sheet.file.name for sheet in sheets] == names
    assert (
        len(list((tmp_path / "o").glob("*/*.exr"))) == 2 * 2 + 2 * 3
    )  # eaw takes no half samples; the reference is there, too


def test_pixels_that_are_not_finite_are_magenta_and_counted(clip_folder, tmp_path):
    shown = frame_at(run_clip(registry.method("mean"), open_clip(clip_folder), 1.0), 0)
    image = shown.image.clone()
    image[0, 1, 3, 4], image[0, 2, 5, 6] = torch.nan, torch.inf
    broken = picture("mean", replace(shown, image=image))
    assert broken.broken == 2
    magenta = (display(broken.radiance) == NONFINITE_COLOUR).all(-1)
    assert np.argwhere(magenta).tolist() == [[3, 4], [5, 6]]


def test_a_method_that_cannot_run_is_left_out_and_alone_it_is_told(clip_folder, tmp_path):
    asked = request(clip_folder, "eaw", "mean", spp=(0.5,))
    (sheet,) = write(asked, 0, tmp_path)
    assert sheet.without == {"eaw": "supports 1 to 8 spp, requested 0.5"}
    assert {file.name for file in tmp_path.glob("*/*.png")} == {"mean.png", "reference.png"}
    with pytest.raises(ImagesError, match="eaw: supports 1 to 8 spp, requested 0.5"):
        list(write(request(clip_folder, "eaw", spp=(0.5,)), 0, tmp_path))


def test_a_method_that_raises_is_told_and_the_others_are_shown(clip_folder, tmp_path):
    registry.use_plugin(
        write_plugin(tmp_path / "odd.py", "odd", body="raise ValueError('no luck')")
    )
    (sheet,) = write(request(clip_folder, "odd", "mean"), 0, tmp_path)
    assert sheet.without == {"odd": "ValueError: no luck"}


@pytest.mark.parametrize("frame", [3, -4])
def test_a_frame_that_is_not_there_is_told(clip_folder, tmp_path, frame):
    with pytest.raises(ImagesError, match=f"--frame {frame}: clip 'noise' has frames 0 to 2"):
        list(write(request(clip_folder, "mean"), frame, tmp_path))


def test_where_samples_went_is_shown_of_a_method_that_adapts(clip_folder, tmp_path):
    body = "return samples.mean, None"
    plugin = write_plugin(tmp_path / "left.py", "left", traits="adaptive=True", body=body)
    code = plugin.read_text().replace(
        "return torch.ones_like(samples.counts, dtype=torch.float32)",
        "return (torch.arange(samples.counts.shape[-1]) < 4).float().expand(samples.counts.shape)",
    )
    plugin.write_text(code)
    registry.use_plugin(plugin)
    plain, adaptive = (
        imread(next(write(request(clip_folder, name), 0, tmp_path / name)).file)
        for name in ("mean", "left")
    )
    assert adaptive.shape[0] > plain.shape[0]  # a row more
