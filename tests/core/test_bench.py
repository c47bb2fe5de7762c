"""Measuring: cells, resuming, and reasons."""

from __future__ import annotations

from pathlib import Path

from rlbench import registry, table
from rlbench.bench import Done, measure
from rlbench.cells import Request
from rlbench.source import Stored


def request(folder: Path, *methods: str, **asked: object) -> Request:
    return Request(
        methods or ("mean",), (Stored(folder),), **{"spp": (1.0,), "repeats": 2, **asked}
    )


def test_every_frame_has_a_row_of_every_metric(clip_folder, tmp_path):
    assert measure(request(clip_folder), tmp_path / "r") == Done(measured=1)
    rows = table.read(tmp_path / "r")
    scored = rows[rows.frame >= 0]
    assert sorted(scored.metric.unique()) == registry.names("metrics")
    assert (scored.groupby("metric").frame.apply(sorted).map(list) == [[0, 1, 2]] * 5).all()
