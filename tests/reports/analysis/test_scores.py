"""Means and times of the made-up results, computed by hand, and what has no mean."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd
import pytest

from reports.analysis.scores import Scores, mean_over_scenes, metrics_with_values, with_misses
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import BUDGETS, METHODS, OFFSET, SAMPLE_MS, SCENES, rows


def test_score_and_frame_time_of_a_scene_are_those_of_the_formulas(results):
    points = Scores(results).points.set_index(["method", "scene", "target_spp"])
    assert len(points) == len(METHODS) * len(SCENES) * len(BUDGETS)
    for (method, scene, spp), row in points.iterrows():
        start, slope, plan, denoise = METHODS[method]
        assert row["value"] == pytest.approx(start + slope * math.log2(spp) + SCENES[scene])
        sampling = 0.99 * spp * SAMPLE_MS[scene]
        assert row["frame_ms"] == pytest.approx(plan + denoise + sampling)


def test_overall_is_the_mean_over_scenes_and_is_computed_once(results):
    scores = Scores(results)
    means = scores.overall.set_index(["method", "target_spp"])
    assert means.loc[("ntas", 1.0), "value"] == pytest.approx(28.6 + OFFSET)
    sampling = 0.99 * sum(SAMPLE_MS.values()) / 4
    assert means.loc[("ntas", 1.0), "frame_ms"] == pytest.approx(6.5 + 14.0 + sampling)
    assert scores.points is scores.points
    assert scores.overall.equals(mean_over_scenes(scores.points))


def test_a_clip_of_many_frames_weighs_no_more_than_another():
    city = [r for r in rows(["ours"]) if (r.metric, r.scene, r.target_spp) == ("psnr", "city", 1)]
    extra = [replace(r, frame=r.frame + 100) for r in city if r.clip == "city-1"]
    means = Scores(to_dataframe(city + extra)).scene_means["value"].item()
    assert means == pytest.approx(METHODS["ours"][0])


def test_seeds_are_averaged_before_frames_are_counted():
    first = [r for r in rows(["ours", "ntas"]) if r.metric == "psnr"]
    again = [replace(r, seed=1, value=r.value + 2) for r in first if r.method == "ours"]
    means = Scores(to_dataframe(first + again)).scene_means
    city = means[(means["scene"] == "city") & (means["target_spp"] == 1.0)].set_index("method")
    assert city["value"].to_dict() == pytest.approx({"ours": 30.9, "ntas": 28.6})


def test_methods_that_lack_frames_or_scenes_have_no_mean_and_are_listed():
    """ntas lacks one frame of the city at 1 spp, and all of the hall."""
    absent = {("city", 1.0, 2)}
    table = [
        r
        for r in rows(["ours", "ntas"])
        if r.method == "ours"
        or not (r.scene == "hall" or (r.scene, r.target_spp, r.frame) in absent)
    ]
    scores = Scores(to_dataframe(table))
    means = scores.scene_means
    of_ntas = means[(means["method"] == "ntas") & (means["scene"] == "city")]
    assert of_ntas["target_spp"].tolist() == [0.5, 2.0, 4.0, 8.0]
    assert set(scores.overall["method"]) == {"ours"}
    assert "ntas on city at 1 spp: psnr of 6 frames, others have 8" in scores.incomplete_groups
    assert "ntas at 2 spp: no psnr on hall" in scores.incomplete_groups


def test_a_method_that_lacks_a_time_has_a_score_and_no_frame_time():
    lacks = ("oidn", "hall", "sampling_ms")
    table = [r for r in rows(["ours", "oidn"]) if (r.method, r.scene, r.metric) != lacks]
    means = Scores(to_dataframe(table)).overall.set_index("method")
    assert means["frame_ms"].isna().groupby("method").all().to_dict() == {
        "oidn": True,
        "ours": False,
    }
    assert means["value"].notna().all()


def test_samples_of_another_pool_have_their_own_cost():
    dear = [replace(r, value=3 * r.value) if r.metric == "sample_ms" else r for r in rows(["ntas"])]
    alone, together = (Scores(to_dataframe(r)).points for r in (dear, rows(["ours"]) + dear))
    together = together[together["method"] == "ntas"].reset_index(drop=True)
    pd.testing.assert_frame_equal(together, alone)


def test_skipped_metrics_times_and_numbers_about_the_clock_are_no_scores():
    first = rows(["ours"])[0]
    skipped = replace(first, metric="ms_ssim", value=math.nan, note="no halves")
    clock = replace(first, frame=-1, metric="clock_rounds", value=4.0, unit="", direction="")
    event = replace(first, metric="event_cut", value=1.0)
    table = to_dataframe([*rows(["ours"]), skipped, clock, event])
    assert metrics_with_values(table) == ["psnr", "relmse"]


def late_table(*rows):
    cell = {"method": "m", "clip": "c", "target_spp": 1.0, "seed": 0, "device": "d"}
    return pd.DataFrame(rows, columns=["metric", "frame", "value"]).assign(**cell)


def test_a_late_frame_counts_with_the_psnr_of_the_image_before():
    table = late_table(("psnr", 0, 30.0), ("psnr", 1, 30.0), ("psnr_late", 1, 20.0))
    others = [table.assign(method="other", value=0.0), table.assign(target_spp=2.0, value=0.0)]
    both = pd.concat([table, *others], ignore_index=True)
    assert with_misses(both, 0.1)["value"][:3].tolist() == pytest.approx([30.0, 29.0, 20.0])


def test_results_without_late_frames_stay_as_they_are():
    table = late_table(("psnr", 0, 30.0), ("psnr", 1, math.nan))
    pd.testing.assert_frame_equal(with_misses(table), table)
