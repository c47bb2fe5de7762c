"""Means and times of the made-up results, computed by hand, and what has no mean."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd
import pytest

from reports.analysis.scores import Scores, mean_over_scenes, metrics_with_values
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import BUDGETS, METHODS, SAMPLE_MS, SCENES, psnr, rows


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("method", ["ours", "mean"])
def test_the_score_of_a_scene_is_the_formula_without_deviations(results, method, scene):
    means = Scores(results).scene_means.set_index(["method", "scene", "target_spp"])["value"]
    start, slope, _, _ = METHODS[method]
    assert means[method, scene, 4.0] == pytest.approx(start + 2 * slope + SCENES[scene])


@pytest.mark.parametrize("spp", BUDGETS)
def test_frame_time_is_plan_and_denoise_and_drawn_samples(results, spp):
    means = Scores(results).points.set_index(["method", "scene", "target_spp"])["frame_ms"]
    assert means["ours", "hall", spp] == pytest.approx(5.5 + 11.0 + 0.99 * spp * SAMPLE_MS["hall"])


def test_overall_is_the_mean_over_scenes(results):
    means = Scores(results).overall.set_index(["method", "target_spp"])
    offset = sum(SCENES.values()) / 4
    assert means.loc[("ntas", 1.0), "value"] == pytest.approx(28.6 + offset)
    sampling = 0.99 * sum(SAMPLE_MS.values()) / 4
    assert means.loc[("ntas", 1.0), "frame_ms"] == pytest.approx(6.5 + 14.0 + sampling)


def test_a_clip_of_many_frames_weighs_no_more_than_another():
    city = [
        r for r in rows(["ours"]) if r.metric == "psnr" and r.scene == "city" and r.target_spp == 1
    ]
    extra = [replace(r, frame=r.frame + 100) for r in city if r.clip == "city-1"]
    means = Scores(to_dataframe(city + extra)).scene_means["value"].item()
    assert means == pytest.approx(METHODS["ours"][0])


def test_seeds_are_averaged_before_frames_are_counted():
    first = [r for r in rows(["ours", "ntas"]) if r.metric == "psnr"]
    again = [replace(r, seed=1, value=r.value + 2) for r in first if r.method == "ours"]
    means = Scores(to_dataframe(first + again)).scene_means
    city = means[(means["scene"] == "city") & (means["target_spp"] == 1.0)]
    assert city.set_index("method")["value"].to_dict() == pytest.approx(
        {"ours": 30.9, "ntas": 28.6}
    )


def incomplete():
    """ntas lacks one frame of the city at 1 spp, and all of the hall."""
    return to_dataframe(
        [
            r
            for r in rows(["ours", "ntas"])
            if r.method == "ours"
            or not (r.scene == "hall" or (r.scene == "city" and r.target_spp == 1 and r.frame == 2))
        ]
    )


def test_a_cell_that_lacks_frames_has_no_mean():
    means = Scores(incomplete()).scene_means
    of_ntas = means[(means["method"] == "ntas") & (means["scene"] == "city")]
    assert of_ntas["target_spp"].tolist() == [0.5, 2.0, 4.0, 8.0]


def test_a_method_that_lacks_a_scene_has_no_overall_mean():
    assert set(Scores(incomplete()).overall["method"]) == {"ours"}


def untimed():
    """oidn has no cost of a sample in the hall."""
    others = [r for r in rows(["ours", "oidn"]) if r.metric != "sample_ms"]
    costs = [r for r in rows(["ours", "oidn"]) if r.metric == "sample_ms"]
    return to_dataframe(others + [r for r in costs if (r.method, r.scene) != ("oidn", "hall")])


def test_a_method_that_lacks_the_time_of_a_scene_has_no_overall_time():
    means = Scores(untimed()).overall.set_index(["method", "target_spp"])
    assert means["frame_ms"].isna().groupby("method").all().to_dict() == {
        "oidn": True,
        "ours": False,
    }
    assert means["value"].notna().all()


def test_methods_without_a_mean_are_listed():
    lines = Scores(incomplete()).incomplete_groups
    assert "ntas on city at 1 spp: psnr of 6 frames, others have 8" in lines
    assert "ntas at 2 spp: no psnr on hall" in lines


def test_a_method_without_time_has_a_score_and_no_total():
    timeless = to_dataframe([r for r in rows(["ours"]) if r.unit != "ms"])
    means = Scores(timeless).points
    assert means["frame_ms"].isna().all()
    assert means["value"].notna().all()


def test_samples_of_another_pool_have_their_own_cost():
    expensive = [
        replace(r, value=3 * r.value) if r.metric == "sample_ms" else r for r in rows(["ntas"])
    ]
    alone, together = (
        Scores(to_dataframe(r)).points for r in (expensive, rows(["ours"]) + expensive)
    )
    together = together[together["method"] == "ntas"].reset_index(drop=True)
    pd.testing.assert_frame_equal(together, alone)


def test_deviations_of_frames_and_clips_have_mean_zero():
    values = [psnr("ours", "city", 1.0, clip, frame) for clip in range(2) for frame in range(4)]
    assert sum(values) / 8 == pytest.approx(METHODS["ours"][0])


def test_metrics_without_values_and_times_are_no_scores():
    skipped = replace(rows(["ours"])[0], metric="ms_ssim", value=math.nan, note="no halves")
    table = to_dataframe([*rows(["ours"]), skipped])
    assert metrics_with_values(table) == ["psnr", "relmse"]


def test_means_of_one_scores_are_computed_once(results):
    scores = Scores(results)
    assert scores.points is scores.points
    assert scores.overall.equals(mean_over_scenes(scores.points))
