"""Kept images: they are those that were scored, and a cell has all of them or none."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from metrics.catalog import PSNR
from metrics.metric import Comparison
from rlbench import registry
from rlbench.benchmark import cell_images
from rlbench.benchmark import results as table
from rlbench.benchmark.cell_images import KeptFrame, KeptImagesError, list_images
from rlbench.benchmark.runner import RunSummary, measure
from rlbench.benchmark.shown_clips import find_shown_clips
from rlbench.clips.stored import open_clip
from rlbench.frames import Samples
from rlbench.run import FrameResult, run_clip
from rlbench.system import paths
from tests.benchmark.test_runner import run_plan, scores, use_method_that_needs_a_file
from tests.conftest import write_plugin
from tests.measuring import measure_scores


def keep(plan, folder: Path) -> RunSummary:
    return measure(plan, folder, keep_images=True, times="none")


def kept(folder: Path) -> dict[str, bytes]:
    """Content of all files of images."""
    files = (file for file in (folder / "images").rglob("*") if file.is_file())
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(files)}


@pytest.fixture
def plan(clip_folder):
    return run_plan(clip_folder, spp=(1.5,))


def test_kept_images_are_those_of_the_method_and_counts_sum_to_the_budget(plan, tmp_path):
    assert keep(plan, tmp_path / "r") == RunSummary(measured=1)
    (cell,) = table.cells(tmp_path / "r")
    images = cell_images.find_images(tmp_path / "r", cell)
    clip = open_clip(plan.clips[0].folder)
    assert (images.clip_digest, images.pool, len(images)) == (clip.digest, "path", len(clip))
    for result in run_clip(registry.load_method("mean"), clip, 1.5):
        frame = images.frame(result.frame.index)
        np.testing.assert_array_equal(frame.image, result.image[0].half().numpy())
        np.testing.assert_array_equal(frame.counts, result.samples.counts[0, 0].numpy())
        assert frame.counts.sum(dtype=np.float64) == round(1.5 * 20 * 24)


def frame_result(image: torch.Tensor, counts: int = 1) -> FrameResult:
    samples = Samples(image[:, None], torch.full_like(image[:, :1], counts).long())
    return FrameResult(None, samples, image, {})


def test_finite_values_stay_finite_and_others_stay_visible():
    values = [math.nan, math.inf, -math.inf, 1e6, -1e6, 0.5]
    image = torch.tensor(values).view(1, 1, 1, -1).expand(1, 3, 1, -1)
    stored = KeptFrame.of(frame_result(image, counts=2048))
    expected = [math.nan, math.inf, -math.inf, 65504, -65504, 0.5]
    np.testing.assert_array_equal(stored.image[0, 0], np.array(expected, np.float16))
    assert (stored.counts == 2048).all()


@pytest.mark.parametrize("target_db", [20, 30, 40, 50])
def test_half_floats_change_psnr_by_less_than_a_hundredth_of_a_decibel(target_db):
    random = torch.Generator().manual_seed(0)
    reference = torch.rand(1, 3, 64, 64, generator=random) ** 2.2
    noise = torch.randn(1, 3, 64, 64, generator=random) * 10 ** (-target_db / 20)
    image = (reference + noise * reference.sqrt()).clamp_min(0)
    stored = torch.from_numpy(KeptFrame.of(frame_result(image)).image).float()[None]
    plain, halved = (PSNR.score(Comparison.of(x, reference, reference)) for x in (image, stored))
    assert target_db - 6 < plain < target_db + 10
    # rounding adds at most (2^-11 relative)^2 of sRGB's square, -75 dB of white, independent noise
    assert abs(plain - halved) < 0.01


def test_an_error_while_images_are_made_leaves_the_scores(clip_folder, tmp_path, caplog):
    needed, plan = use_method_that_needs_a_file(tmp_path), run_plan(clip_folder, "odd")
    measure_scores(plan, tmp_path / "r")
    before = table.read(tmp_path / "r")
    needed.unlink()
    done = keep(plan, tmp_path / "r")
    assert (done, [cell.method for cell in done.failures]) == (RunSummary(failed=1), ["odd"])
    assert "no images, its scores stay: FileNotFoundError: " in caplog.text
    assert table.read(tmp_path / "r").equals(before)
    needed.touch()
    assert keep(plan, tmp_path / "r") == RunSummary(measured=1)


@pytest.mark.parametrize("lost", ["images", "images/*/0001.exr", "images/*/cell.json"])
def test_a_cell_without_all_of_its_images_is_run_again_and_keeps_its_scores(plan, tmp_path, lost):
    keep(plan, tmp_path / "r")
    before, images = scores(tmp_path / "r"), kept(tmp_path / "r")
    (path,) = (tmp_path / "r").glob(lost)
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert keep(plan, tmp_path / "r") == RunSummary(measured=1)
    assert (scores(tmp_path / "r"), kept(tmp_path / "r")) == (before, images)
    assert keep(plan, tmp_path / "r") == RunSummary(cached=1)


def test_a_run_without_the_option_and_new_times_leave_images_as_they_are(plan, tmp_path):
    keep(plan, tmp_path / "r")
    before = kept(tmp_path / "r")
    assert measure(plan, tmp_path / "r") == RunSummary(timed=1)
    assert measure(replace(plan, cost="paper-2080ti"), tmp_path / "r") == RunSummary(timed=1)
    assert kept(tmp_path / "r") == before
    assert keep(replace(plan, cost="paper-2080ti"), tmp_path / "r") == RunSummary(cached=1)


@pytest.mark.parametrize("keeps", [True, False])
def test_rows_and_images_of_older_code_are_removed(clip_folder, tmp_path, keeps):
    file = write_plugin(tmp_path / "gain.py", "gain", gain=1.0)
    registry.use_plugin(file)
    keep(run_plan(clip_folder, "gain"), tmp_path / "r")
    (older,) = (tmp_path / "r" / "images").iterdir()
    write_plugin(file, "gain", gain=2.0)
    registry.clear_plugins()
    registry.use_plugin(file)
    plan = run_plan(clip_folder, "gain")
    done = measure(plan, tmp_path / "r", keep_images=keeps, times="none")
    assert (done, done.replaced) == (RunSummary(measured=1), 1)
    assert len(table.cells(tmp_path / "r")) == 1
    assert not older.exists()
    assert len(list((tmp_path / "r" / "images").iterdir())) == keeps


@pytest.mark.parametrize(
    ("module", "step"),
    [(table, "write_cell"), (paths, "publish_folder")],  # after images have their name, and before
)
def test_a_run_that_is_killed_while_it_writes_leaves_an_unfinished_cell(
    plan, tmp_path, monkeypatch, module, step
):
    def kill(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, step, kill)
    with pytest.raises(KeyboardInterrupt):
        keep(plan, tmp_path / "r")
    assert not table.cells(tmp_path / "r")
    assert bool(kept(tmp_path / "r")) == (step == "write_cell")
    monkeypatch.undo()
    assert keep(plan, tmp_path / "r") == RunSummary(measured=1)
    assert len(list((tmp_path / "r" / "images").iterdir())) == 1


def test_a_cell_that_cannot_run_has_no_images_and_is_not_run_for_them(clip_folder, tmp_path):
    plan = run_plan(clip_folder, "eaw", spp=(0.5,))  # eaw takes no half samples
    assert keep(plan, tmp_path / "r") == RunSummary(skipped=1)
    assert not kept(tmp_path / "r")
    assert keep(plan, tmp_path / "r") == RunSummary(cached=1)


def test_a_changed_byte_is_found_when_the_image_is_read(plan, tmp_path):
    keep(plan, tmp_path / "r")
    (images,) = cell_images.list_images(tmp_path / "r")
    file = cell_images.frame_file(images.folder, 2)
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    assert images.frame(1).image.shape == (3, 20, 24)
    with pytest.raises(KeptImagesError, match=r"0002\.exr cannot be read: its content is not"):
        images.frame(2)
    (images.folder / "cell.json").write_text('{"schema": 9}')
    with pytest.raises(KeptImagesError, match="it has schema 9, this version reads 1"):
        cell_images.list_images(tmp_path / "r")


def test_images_reference_and_buffers_are_those_on_disk(clip_folder, tmp_path):
    plan = run_plan(clip_folder, spp=(1.0, 2.0), seeds=(0, 1))
    keep(plan, tmp_path / "r")
    (shown,) = find_shown_clips(tmp_path / "r", plan.clips, ["mean"], [2.0])
    clip = open_clip(clip_folder)
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
    (named,) = find_shown_clips(tmp_path / "r", plan.clips, ["mean"], [2.0], buffers=["depth"])
    assert list(named.buffers) == ["depth"]
