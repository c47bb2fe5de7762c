"""Sentences about skipped and measured rows."""

from __future__ import annotations

import math
from dataclasses import replace

from reports.analysis import notes
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import rows


def test_a_reason_is_listed_once_for_a_method():
    skipped = replace(rows(["ours"])[0], method="restir", value=math.nan, note="no restir pool")
    lines = notes.skip_reasons(to_dataframe([skipped, replace(skipped, scene="hall", frame=1)]))
    assert lines == ["restir on city, hall at 0.5 spp (psnr): no restir pool"]


def test_a_remark_is_listed_once_for_a_method_and_metric():
    measured = [replace(r, note="trained on this clip") for r in rows(["ours"])[:2]]
    skipped = replace(measured[0], value=math.nan, note="needs CUDA")
    lines = notes.remarks(to_dataframe([*measured, skipped]))
    assert lines == [
        "ours, psnr: trained on this clip",
        "ours, relmse: trained on this clip",
    ]
