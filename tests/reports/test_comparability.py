"""Rows that must not share a mean are refused: devices, presets, versions, costs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from reports.analysis.rows import ReportError, check_comparable, split_by_device
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import rows


def test_two_devices_are_refused():
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], device="H100"))
    with pytest.raises(ReportError, match="mixes 2 devices: H100, NVIDIA RTX"):
        check_comparable(mixed)


def test_a_clip_of_two_presets_is_refused():
    one = [replace(row, preset="mini") for row in rows(["ours"])]
    other = [replace(row, preset="standard") for row in rows(["ours/latent-small"])]
    with pytest.raises(ReportError, match=r"city-0 .* 2 presets \(mini, standard\)"):
        check_comparable(to_dataframe(one + other))


def test_rows_are_split_by_device():
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], device="H100"))
    parts = {name: set(part["method"]) for name, part in split_by_device(mixed).items()}
    assert parts == {"H100": {"ntas"}, "NVIDIA RTX 2080 Ti": {"ours"}}


def test_the_machine_that_rendered_is_not_a_device_of_the_methods():
    rendered = [replace(r, device="farm") if r.metric == "sample_ms" else r for r in rows(["ours"])]
    assert list(split_by_device(to_dataframe(rendered))) == ["NVIDIA RTX 2080 Ti"]


def test_two_costs_per_sample_are_refused():
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], profile="this machine"))
    with pytest.raises(ReportError, match="2 sources: profile paper-2080ti; this .*--out"):
        check_comparable(mixed)


@pytest.mark.parametrize("column", ["code_hash", "weights_hash", "dtype"])
def test_two_versions_of_a_method_are_refused(column):
    mixed = rows(["ours"])
    mixed[0] = replace(mixed[0], **{column: "other"})
    with pytest.raises(ReportError, match=f"'ours' has results of 2 {column} values"):
        check_comparable(to_dataframe(mixed))


def test_an_empty_table_is_refused():
    with pytest.raises(ReportError, match="has no rows"):
        check_comparable(to_dataframe(rows(["ours"])).iloc[:0])


def cross_validated(**weights):
    """Rows of ours whose weights differ by scene; `weights` replaces those of single clips."""
    folds = [
        replace(r, method="ours@crossval", weights_hash=f"without {r.scene} {len(r.scene)}")
        for r in rows(["ours"])
        if r.metric == "psnr"
    ]
    return to_dataframe(
        [replace(r, weights_hash=weights.get(r.clip, r.weights_hash)) for r in folds]
    )


def test_weights_that_differ_by_held_out_scene_are_comparable():
    check_comparable(cross_validated())


def test_weights_that_differ_for_one_held_out_scene_are_refused():
    with pytest.raises(ReportError, match="'ours@crossval' has results of 2 weights"):
        check_comparable(cross_validated(**{"city-1": "without city 0"}))
