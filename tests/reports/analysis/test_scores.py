"""Rows that must not share a mean, sentences about notes, and means computed by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd
import pytest

from reports.analysis import rows as analysed
from reports.analysis.rows import ReportError, check_comparable, split_by_device
from reports.analysis.scores import Scores, mean_over_scenes, metrics_with_values, with_misses
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import BUDGETS, METHODS, OFFSET, SAMPLE_MS, SCENES, rows


@pytest.mark.parametrize(
    ("method", "parts"),
    [
        ("ours", ("ours", "ours", "", "")),
        ("ours/A2@seed12", ("ours", "ours/A2", "seed12", "ours/A2@seed")),
        ("restir+oidn@long", ("restir+oidn", "restir+oidn", "long", "restir+oidn@long")),
    ],
)
def test_a_name_has_family_method_label_and_training_series(method, parts):
    readers = ("family_of", "without_label", "label_of", "training_series_of")
    assert tuple(getattr(analysed, reader)(method) for reader in readers) == parts


def changed(column, first, other):
    """Rows of two methods that differ in a column."""
    one = [replace(row, **{column: first}) for row in rows(["ours"])]
    return one + [replace(row, **{column: other}) for row in rows(["ours/latent-small"])]


REFUSED = {
    "devices": (changed("device", "A", "B"), "A, B"),
    "presets": (changed("preset", "mini", "standard"), r"city-0 .*mini, standard"),
    "sizes": (changed("size", "192x192", "640x360"), "192x192 and 640x360"),
    "costs": (rows(["ours"]) + rows(["ntas"], profile="this machine"), "2 sources"),
    "rows": ([], "no rows"),
} | {
    column: ([replace(rows(["ours"])[0], **{column: "other"}), *rows(["ours"])[1:]], column)
    for column in ("code_hash", "weights_hash", "dtype")
}


@pytest.mark.parametrize("kind", REFUSED)
def test_rows_that_cannot_be_compared_are_refused(kind):
    table, message = REFUSED[kind]
    with pytest.raises(ReportError, match=message):
        check_comparable(to_dataframe(table))


def test_films_of_other_shapes_and_about_as_many_pixels_are_comparable():
    check_comparable(to_dataframe(changed("size", "192x192", "256x144")))


def test_rows_are_split_by_the_device_of_methods_not_by_that_which_rendered():
    rendered = [replace(r, device="farm") if r.metric == "sample_ms" else r for r in rows(["ours"])]
    parts = split_by_device(to_dataframe(rendered + rows(["ntas"], device="H100")))
    methods = {name: set(part["method"]) - {"farm"} for name, part in parts.items()}
    assert set(methods) == {"H100", "NVIDIA RTX 2080 Ti"}
    assert "ours" not in set(parts["H100"].loc[parts["H100"]["metric"] == "psnr", "method"])


@pytest.mark.parametrize(("clip", "is_refused"), [("", False), ("city-1", True)])
def test_weights_may_differ_by_held_out_scene_alone(clip, is_refused):
    folds = [
        replace(r, weights_hash="without city 0" if r.clip == clip else f"without {r.scene} 1")
        for r in rows(["ours"])
    ]
    if is_refused:
        with pytest.raises(ReportError, match="weights"):
            check_comparable(to_dataframe(folds))
    else:
        check_comparable(to_dataframe(folds))


def test_a_reason_is_listed_once_for_a_method():
    skipped = replace(rows(["ours"])[0], method="restir", value=math.nan, note="no restir pool")
    table = to_dataframe([skipped, replace(skipped, scene="hall", frame=1)])
    assert analysed.skip_reasons(table) == [
        "restir on city, hall at 0.5 spp (psnr): no restir pool"
    ]
    many = [replace(skipped, scene=f"generated-{i}") for i in range(48)]
    assert analysed.skip_reasons(to_dataframe(many)) == [
        "restir on 48 scenes at 0.5 spp (psnr): no restir pool"
    ]


def test_a_remark_is_listed_once_for_a_method_and_metric_and_is_not_about_times():
    measured = [replace(r, note="trained on this clip") for r in rows(["ours"])[:2]]
    skipped = replace(measured[0], value=math.nan, note="needs CUDA")
    busy = replace(measured[0], metric="plan_ms", unit="ms", note="uncertain: busy")
    assert analysed.remarks(to_dataframe([*measured, skipped, busy])) == [
        "ours, psnr: trained on this clip",
        "ours, relmse: trained on this clip",
    ]


def test_the_reason_for_uncertain_times_is_one_line_for_all_rows_that_share_it():
    times = [r for r in rows(["ours"]) if r.metric == "plan_ms"]
    busy = [replace(r, metric="inference_ms", note="uncertain: busy") for r in times]
    (line,) = analysed.uncertain_times(to_dataframe(busy))
    assert (
        line == "inference_ms of ours on city, hall, ripples, temple at 0.5, 1, 2, 4, 8 spp: busy"
    )


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
    city = rows(["ours"], metric="psnr", scene="city", target_spp=1)
    extra = [replace(r, frame=r.frame + 100) for r in city if r.clip == "city-1"]
    means = Scores(to_dataframe(city + extra)).scene_means["value"].item()
    assert means == pytest.approx(METHODS["ours"][0])


def test_seeds_are_averaged_before_frames_are_counted():
    first = rows(["ours", "ntas"], metric="psnr")
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
    lacks_time = means["frame_ms"].isna().groupby("method").all()
    assert lacks_time.to_dict() == {"oidn": True, "ours": False}
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
