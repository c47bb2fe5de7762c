"""Reading the table: means and times by hand, and nothing averaged that must not be."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd
import pytest
from conftest import BUDGETS, METHODS, SAMPLE_MS, SCENES, psnr, rows

from reports.analysis import aggregate
from rlbench.benchmark.results import to_dataframe


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("method", ["ours", "mean"])
def test_the_score_of_a_scene_is_the_formula_without_its_wobbles(results, method, scene):
    found = aggregate.scene_means(results, "psnr").set_index(["method", "scene", "target_spp"])[
        "value"
    ]
    start, slope, _, _ = METHODS[method]
    assert found[method, scene, 4.0] == pytest.approx(start + 2 * slope + SCENES[scene])


@pytest.mark.parametrize("spp", BUDGETS)
def test_total_time_is_plan_and_denoise_and_the_samples_bought(results, spp):
    found = aggregate.points(results).set_index(["method", "scene", "target_spp"])["frame_ms"]
    assert found["ours", "hall", spp] == pytest.approx(5.5 + 11.0 + 0.99 * spp * SAMPLE_MS["hall"])


def test_overall_is_the_mean_over_scenes(results):
    found = aggregate.overall(aggregate.points(results)).set_index(["method", "target_spp"])
    offset = sum(SCENES.values()) / 4
    assert found.loc[("ntas", 1.0), "value"] == pytest.approx(28.6 + offset)
    sampling = 0.99 * sum(SAMPLE_MS.values()) / 4
    assert found.loc[("ntas", 1.0), "frame_ms"] == pytest.approx(6.5 + 14.0 + sampling)


def test_a_clip_of_many_frames_weighs_no_more_than_another():
    made = [
        r for r in rows(["ours"]) if r.metric == "psnr" and r.scene == "city" and r.target_spp == 1
    ]
    extra = [replace(r, frame=r.frame + 100) for r in made if r.clip == "city-1"]
    found = aggregate.scene_means(to_dataframe(made + extra), "psnr")["value"].item()
    assert found == pytest.approx(METHODS["ours"][0])


def test_seeds_are_averaged_before_frames_are_counted():
    made = [r for r in rows(["ours", "ntas"]) if r.metric == "psnr"]
    again = [replace(r, seed=1, value=r.value + 2) for r in made if r.method == "ours"]
    found = aggregate.scene_means(to_dataframe(made + again), "psnr")
    cells = found[(found["scene"] == "city") & (found["target_spp"] == 1.0)].set_index("method")[
        "value"
    ]
    assert cells.to_dict() == pytest.approx({"ours": 30.9, "ntas": 28.6})


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
    found = aggregate.scene_means(incomplete(), "psnr")
    of_ntas = found[(found["method"] == "ntas") & (found["scene"] == "city")]
    assert of_ntas["target_spp"].tolist() == [0.5, 2.0, 4.0, 8.0]


def test_a_method_that_lacks_a_scene_has_no_overall_mean():
    assert set(aggregate.overall(aggregate.points(incomplete()))["method"]) == {"ours"}


def untimed():
    """oidn has no cost of a sample in the hall."""
    made = [r for r in rows(["ours", "oidn"]) if r.metric != "sample_ms"]
    costs = [r for r in rows(["ours", "oidn"]) if r.metric == "sample_ms"]
    return to_dataframe(made + [r for r in costs if (r.method, r.scene) != ("oidn", "hall")])


def test_a_method_that_lacks_the_time_of_a_scene_has_no_overall_time():
    found = aggregate.overall(aggregate.points(untimed())).set_index(["method", "target_spp"])
    assert found["frame_ms"].isna().groupby("method").all().to_dict() == {
        "oidn": True,
        "ours": False,
    }
    assert found["value"].notna().all()


def test_what_was_left_out_is_told():
    lines = aggregate.incomplete_groups(incomplete(), "psnr")
    assert "ntas on city at 1 spp: psnr of 6 frames, others have 8" in lines
    assert "ntas at 2 spp: no psnr on hall" in lines


def test_a_method_without_time_has_a_score_and_no_total():
    timeless = to_dataframe([r for r in rows(["ours"]) if r.unit != "ms"])
    found = aggregate.points(timeless)
    assert found["frame_ms"].isna().all()
    assert found["value"].notna().all()


def test_two_devices_do_not_share_a_column():
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], device="H100"))
    with pytest.raises(aggregate.ReportError, match="2 devices in one column: H100, NVIDIA RTX"):
        aggregate.check(mixed)


def test_a_clip_of_two_presets_is_refused():
    one = [replace(row, preset="mini") for row in rows(["ours"])]
    other = [replace(row, preset="standard") for row in rows(["ours/small"])]
    with pytest.raises(aggregate.ReportError, match=r"city-0 .* 2 presets \(mini, standard\)"):
        aggregate.check(to_dataframe(one + other))


def test_rows_are_split_by_device():
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], device="H100"))
    parts = {name: set(part["method"]) for name, part in aggregate.by_device(mixed).items()}
    assert parts == {"H100": {"ntas"}, "NVIDIA RTX 2080 Ti": {"ours"}}


def test_the_machine_that_rendered_is_not_a_device_of_the_methods():
    made = [replace(r, device="farm") if r.metric == "sample_ms" else r for r in rows(["ours"])]
    assert list(aggregate.by_device(to_dataframe(made))) == ["NVIDIA RTX 2080 Ti"]


def test_samples_of_another_pool_have_their_own_price():
    dear = [replace(r, value=3 * r.value) if r.metric == "sample_ms" else r for r in rows(["ntas"])]
    alone, beside = (aggregate.points(to_dataframe(made)) for made in (dear, rows(["ours"]) + dear))
    beside = beside[beside["method"] == "ntas"].reset_index(drop=True)
    pd.testing.assert_frame_equal(beside, alone)


def test_two_costs_per_sample_are_refused():
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], profile="this machine"))
    with pytest.raises(
        aggregate.ReportError, match="2 sources: profile paper-2080ti; this .*--out"
    ):
        aggregate.check(mixed)


@pytest.mark.parametrize("column", ["code_hash", "weights_hash", "dtype"])
def test_two_versions_of_a_method_are_refused(column):
    made = rows(["ours"])
    made[0] = replace(made[0], **{column: "other"})
    with pytest.raises(aggregate.ReportError, match=f"'ours' has results of 2 {column} values"):
        aggregate.check(to_dataframe(made))


def test_an_empty_table_is_refused():
    with pytest.raises(aggregate.ReportError, match="has no rows"):
        aggregate.check(to_dataframe(rows(["ours"])).iloc[:0])


def test_reasons_are_told_once_for_each_method():
    hole = replace(rows(["ours"])[0], method="restir", value=math.nan, note="no restir pool")
    lines = aggregate.reasons(to_dataframe([hole, replace(hole, scene="hall", frame=1)]))
    assert lines == ["restir on city, hall at 0.5 spp (psnr): no restir pool"]


@pytest.mark.parametrize(
    ("better", "expected"), [("higher", [0, 2, 3]), ("lower", [0, 1])], ids=["higher", "lower"]
)
def test_the_front_is_what_none_beats(better, expected):
    times, values = pd.Series([1.0, 2.0, 3.0, 4.0, 4.0]), pd.Series([5.0, 4.0, 6.0, 9.0, 7.0])
    assert aggregate.pareto_front(times, values, better) == expected


def test_wobbles_of_the_made_up_table_have_mean_zero():
    values = [psnr("ours", "city", 1.0, clip, frame) for clip in range(2) for frame in range(4)]
    assert sum(values) / 8 == pytest.approx(METHODS["ours"][0])


def crossvalidated(**weights):
    """Rows of ours, whose weights differ by scene; `weights` are those of single clips."""
    made = [
        replace(r, method="ours@crossval", weights_hash=f"without {r.scene} {len(r.scene)}")
        for r in rows(["ours"])
        if r.metric == "psnr"
    ]
    return to_dataframe(
        [replace(r, weights_hash=weights.get(r.clip, r.weights_hash)) for r in made]
    )


def test_weights_that_differ_by_the_scene_left_out_share_a_column():
    aggregate.check(crossvalidated())


def test_weights_that_differ_within_a_scene_left_out_do_not():
    with pytest.raises(aggregate.ReportError, match="'ours@crossval' has results of 2 weights"):
        aggregate.check(crossvalidated(**{"city-1": "without city 0"}))
