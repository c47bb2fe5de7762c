"""Parts of names, rows that must not share a mean, and sentences about notes."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from reports.analysis import rows as analysed
from reports.analysis.rows import ReportError, check_comparable, split_by_device
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import rows


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
