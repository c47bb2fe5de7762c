"""Scoring kept images again: the numbers of a run, for any metric, only where they are missing."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from metrics.catalog import PSNR
from rlbench import registry
from rlbench.benchmark import results as table
from rlbench.benchmark.cell_images import KeptImagesError, find_kept_cells
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.evaluation import (
    EvaluatedMetric,
    EvaluationSummary,
    evaluate,
    select_metrics,
)
from rlbench.benchmark.runner import CellRunner
from rlbench.clips.stored import open_clip
from tests.benchmark.test_cell_images import keep
from tests.benchmark.test_runner import change_code, run_plan
from tests.conftest import write_noise, write_plugin
from tests.measuring import measure_scores

HALF_DB = 0.01  # what half floats may change, see test_cell_images


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> Path:
    """A clip, and the results of two methods at two budgets with their images."""
    folder = tmp_path_factory.mktemp("measured")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(folder / "cache"))
        plan = run_plan(write_noise(folder / "noise"), "mean", "eaw", spp=(1.0, 2.0))
        keep(plan, folder / "r")
    return folder


@pytest.fixture
def clip_folder(measured, tmp_path) -> Path:
    return shutil.copytree(measured / "noise", tmp_path / "clips" / "noise")


@pytest.fixture
def results(measured, tmp_path) -> Path:
    return shutil.copytree(measured / "r", tmp_path / "r")


def score(results: Path, clip: Path, *metrics, **selection) -> EvaluationSummary:
    chosen = [each for each in metrics if isinstance(each, EvaluatedMetric)]
    chosen += select_metrics(each for each in metrics if isinstance(each, str))
    cells = find_kept_cells(results, [StoredSource(clip)], **selection)
    return evaluate(results, cells, chosen, results / "evaluated")


def custom(name: str, function, **traits) -> EvaluatedMetric:
    """A metric of this test, with a hash of its name."""
    return EvaluatedMetric(
        replace(PSNR, name=name, score=function, scored_by_run=False, **traits), f"hash of {name}"
    )


def by_frame(folder: Path, metric: str):
    rows = table.read(folder)
    rows = rows[(rows["metric"] == metric) & rows["value"].notna()]
    return rows.set_index(["method", "target_spp", "frame"]).sort_index()


def test_scores_of_kept_images_are_those_of_the_run(results, clip_folder):
    names = [n for n, m in registry.load_run_metrics().items() if m.at(20, 24).name == n]
    assert score(results, clip_folder, *names).scored == 4 * len(names)
    for name in names:
        run, evaluated = by_frame(results, name), by_frame(results / "evaluated", name)
        assert len(run) == len(evaluated) > 0
        if name in ("psnr", "tpsnr"):
            assert abs(run["value"] - evaluated["value"]).max() < HALF_DB
        else:  # half floats have 11 bits
            assert evaluated["value"].to_numpy() == pytest.approx(
                run["value"].to_numpy(), rel=5e-3, abs=1e-5
            )
        same = ["clip", "mean_spp", "seed", "device", "code_hash", "run_id", "config", "unit"]
        assert run[same].equals(evaluated[same])


def test_scored_cells_are_not_scored_again_and_new_metrics_are(results, clip_folder, monkeypatch):
    assert score(results, clip_folder, "psnr") == EvaluationSummary(scored=4)
    before = {file.name: file.stat().st_mtime_ns for file in (results / "evaluated").iterdir()}
    assert score(results, clip_folder, "psnr", "relmse") == EvaluationSummary(scored=4, cached=4)
    after = {file.name: file.stat().st_mtime_ns for file in (results / "evaluated").iterdir()}
    assert before.items() <= after.items()
    change_code(monkeypatch, "rlbench.benchmark.scoring")  # makes the ground truth
    assert score(results, clip_folder, "psnr") == EvaluationSummary(scored=4)


def test_scores_of_older_images_are_removed(clip_folder, tmp_path):
    file = write_plugin(tmp_path / "gain.py", "gain", gain=1.0)
    for gain in (1.0, 2.0):
        write_plugin(file, "gain", gain=gain)
        registry.clear_plugins()
        registry.use_plugin(file)
        keep(run_plan(clip_folder, "gain"), tmp_path / "r")
        metrics = ("psnr", "relmse") if gain == 1.0 else ("psnr",)
        score(tmp_path / "r", clip_folder, *metrics)
    rows = table.read(tmp_path / "r" / "evaluated")
    assert set(rows["metric"]) == {"psnr"}
    assert by_frame(tmp_path / "r", "psnr")["value"].to_numpy() == pytest.approx(
        by_frame(tmp_path / "r" / "evaluated", "psnr")["value"].to_numpy(), abs=HALF_DB
    )


def test_a_metric_may_be_of_the_whole_clip_and_read_motion_and_counts(results, clip_folder):
    def moved(comparison):
        has_both = comparison.motion is not None and comparison.counts is not None
        return comparison.counts.float().mean((1, 2, 3)) if has_both else None

    frames = custom("frames", lambda comparisons: float(len(comparisons)), whole_clip=True)
    score(results, clip_folder, frames, custom("moved", moved, needs=("motion", "counts")))
    rows = table.read(results / "evaluated")
    rows = rows[rows["metric"] == "frames"]
    assert (rows["value"].tolist(), set(rows["frame"])) == ([3.0] * 4, {table.WHOLE_CLIP})
    values = by_frame(results / "evaluated", "moved").reset_index()
    assert values["value"].to_numpy() == pytest.approx(values["target_spp"].to_numpy())


def test_a_metric_that_fails_is_a_row_with_the_reason_and_is_tried_again(results, clip_folder):
    def fail(comparison):
        raise ZeroDivisionError("no luck")

    done = score(results, clip_folder, "psnr", custom("broken", fail), methods=["mean"])
    assert done.scored == 2
    assert len(done.failures) == 2
    assert "1 spp, seed 0, broken: ZeroDivisionError: no luck" in done.failures[0]
    rows = table.read(results / "evaluated")
    (note,) = set(rows[rows["metric"] == "broken"]["note"])
    assert note == "ZeroDivisionError: no luck"
    mended = custom("broken", PSNR.score)
    assert score(results, clip_folder, mended, methods=["mean"]) == EvaluationSummary(scored=2)
    assert not table.read(results / "evaluated")["value"].isna().any()


def test_images_of_another_clip_are_refused(results, tmp_path):
    other = write_noise(tmp_path / "other" / "noise", scene="noise")
    changed = open_clip(other).digest
    shutil.copy(other / "referenceA.0002.exr", other / "referenceA.0001.exr")
    assert open_clip(other).digest != changed
    with pytest.raises(KeptImagesError, match=r"show a clip with digest \w+, but .*other/noise"):
        score(results, other, "psnr")


def test_results_without_images_are_refused(clip_folder, tmp_path, results):
    measure_scores(run_plan(clip_folder), tmp_path / "plain")
    with pytest.raises(KeptImagesError, match="has no images of any method on noise"):
        score(tmp_path / "plain", clip_folder, "psnr")
    with pytest.raises(KeptImagesError, match="it has eaw, mean on noise"):
        score(results, clip_folder, "psnr", methods=["svgf"])


def test_an_image_that_is_not_finite_scores_as_in_the_run_with_its_remark(
    clip_folder, tmp_path, monkeypatch
):
    body = "return samples.mean * float('nan'), None"
    registry.use_plugin(write_plugin(tmp_path / "nan.py", "nan", body=body))
    monkeypatch.setattr(CellRunner, "_remarks", lambda *_: "no test")
    keep(run_plan(clip_folder, "nan"), tmp_path / "r")
    score(tmp_path / "r", clip_folder, "nonfinite", "psnr")
    rows = table.read(tmp_path / "r" / "evaluated")
    assert set(rows[rows["metric"] == "nonfinite"]["value"]) == {20.0 * 24}
    assert not any(math.isnan(value) for value in rows["value"])
    assert set(rows["note"]) == {"no test"}
