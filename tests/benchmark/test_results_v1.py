"""Results of schema 1, written by an older version, are read under today's names.

`data/schema-1` holds two cells of `rlbench run --scenes city --limit-frames 2 --spp 1 --cost
paper-2080ti`: of `-m mean`, and of `-m ours/A2 --half`.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from reports.analysis.aggregate import Scores
from rlbench.benchmark import results
from rlbench.benchmark.cell_key import FAILED, CellsError
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.results import CellId, CellKey
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import RunSummary, measure
from tests.conftest import write_noise

FOLDER = Path(__file__).parent / "data" / "schema-1"
CPU = "AMD EPYC, 1 threads"


def test_columns_metrics_directions_and_row_names_are_todays():
    table = results.read(FOLDER)
    assert list(table.columns) == list(results.COLUMNS)
    assert set(table["method"]) == {"mean", "ours/A2@bf16"}
    assert set(table["direction"]) == {"higher", "lower", ""}
    assert {"frame_ms", "sample_fetch_ms", "sample_fetch_p95_ms"} <= set(table["metric"])
    assert not {"total_ms", "buy_ms", "buy_p95_ms"} & set(table["metric"])


def test_no_value_is_changed():
    files = sorted(FOLDER.glob("*.parquet"))
    old = pd.concat([pq.read_table(file).to_pandas() for file in files], ignore_index=True)
    new = results.read(FOLDER)
    renamed = {"run": "run_id", "spp": "target_spp", "spp_realised": "mean_spp"}
    renamed |= {"code": "code_hash", "weights": "weights_hash"}
    kept = ["value", "frame", "clip", "unit", "convention", "note", "config", "device", "dtype"]
    for before, after in {**renamed, **dict(zip(kept, kept, strict=True))}.items():
        pd.testing.assert_series_equal(old[before], new[after], check_names=False)


def test_cells_have_a_key():
    keys = {cell.key for cell in results.cells(FOLDER)}
    assert keys == {
        CellKey(method, "city", 1.0, 0, CPU, "mini", first_frames_only=True)
        for method in ("mean", "ours/A2@bf16")
    }


def test_a_report_can_be_made():
    times = Scores(results.read(FOLDER)).points.set_index("method")["frame_ms"]
    assert times["mean"] == pytest.approx(2.600241)


def old_cell(folder: Path, name: str, **columns: object) -> CellId:
    """Write the shipped cell of `mean` with other columns under an old name; its identity."""
    (file,) = FOLDER.glob("mean*.parquet")
    table = pq.read_table(file)
    rows = table.to_pandas().assign(**columns)
    schema = table.schema.with_metadata({b"cell": name.encode()})
    folder.mkdir(exist_ok=True)
    pq.write_table(pa.Table.from_pandas(rows, schema, preserve_index=False), folder / "a.parquet")
    (cell,) = results.cells(folder)
    return cell


def test_a_cell_that_failed_is_a_failed_cell(tmp_path):
    assert old_cell(tmp_path, "mean city 1spp seed0 cpu failed").content_hash == FAILED


def test_an_old_cell_is_measured_again_and_replaced(tmp_path, plan):
    device = measure_elsewhere(plan, tmp_path)
    old = old_cell(
        tmp_path / "r", "mean noise 1spp seed0 x mini,,0123", clip="noise", device=device
    )
    assert not old.key.first_frames_only
    assert measure(plan, tmp_path / "r") == RunSummary(measured=1)
    (cell,) = results.cells(tmp_path / "r")
    assert cell.key == old.key
    assert cell != old


def test_an_old_cell_is_not_lost_to_first_frames_or_another_preset(tmp_path, plan):
    device = measure_elsewhere(plan, tmp_path)
    name = "mean noise 1spp seed0 x mini,,0123"
    for changes, message in (({}, "whole clip"), ({"preset": "large"}, "preset large")):
        old_cell(tmp_path / "r", name, clip="noise", device=device, **changes)
        short = RunPlan(plan.methods, plan.clips, plan.target_spp, limit_frames=1, repeats=2)
        with pytest.raises(CellsError, match=message):
            measure(short, tmp_path / "r")


def test_old_and_new_cells_stand_in_one_table(tmp_path, plan):
    shutil.copytree(FOLDER, tmp_path / "r")
    measure(plan, tmp_path / "r")
    assert set(results.read(tmp_path / "r")["clip"]) == {"city", "noise"}
    assert len(results.cells(tmp_path / "r")) == 3


@pytest.fixture
def plan(tmp_path) -> RunPlan:
    folder = write_noise(tmp_path / "noise", preset="mini")
    return RunPlan(("mean",), (StoredSource(folder),), (1.0,), repeats=2, cost="paper-2080ti")


def measure_elsewhere(plan: RunPlan, folder: Path) -> str:
    """The device under which a plan's cells are stored."""
    measure(plan, folder / "elsewhere")
    (cell,) = results.cells(folder / "elsewhere")
    return cell.key.device
