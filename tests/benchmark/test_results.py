"""The results table: what is written is read back, and what is unfinished is not there."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import asdict, replace

import pandas as pd
import pyarrow.parquet as pq
import pytest

from rlbench.benchmark.results import (
    COLUMNS,
    Row,
    TableError,
    cells,
    drop_cell,
    read,
    select_methods,
    to_dataframe,
    write_cell,
)

ROW = Row("r", "ours/A1", "city-0", "city", 2.0, 1.99, 0, "psnr", 31.25, "dB", "high", "sRGB")
MISSING = replace(ROW, frame=-1, value=math.nan, note="needs CUDA")


def test_what_is_written_is_read_back(tmp_path):
    write_cell(tmp_path, "a", [ROW, replace(ROW, frame=1, value=1 / 3)])
    assert read(tmp_path).to_dict("records") == [
        asdict(ROW),
        asdict(ROW) | {"frame": 1, "value": 1 / 3},
    ]


def test_a_missing_value_keeps_its_note(tmp_path):
    write_cell(tmp_path, "a", [MISSING])
    found = read(tmp_path).iloc[0]
    assert (math.isnan(found["value"]), found["note"]) == (True, "needs CUDA")


def test_columns_have_the_documented_types(tmp_path):
    write_cell(tmp_path, "a", [MISSING])
    kinds = {name: dtype.kind for name, dtype in read(tmp_path).dtypes.items()}
    numbers = {"frame": "i", "seed": "i", "spp": "f", "spp_realised": "f", "value": "f"}
    assert {name: kinds[name] for name in numbers} == numbers
    assert tuple(kinds) == COLUMNS


def test_text_columns_are_strings_without_gaps(tmp_path):
    write_cell(tmp_path, "a", [ROW])
    table = read(tmp_path)
    assert pd.api.types.is_string_dtype(table["note"])
    assert not table["note"].isna().any()


@pytest.mark.parametrize(
    "cell", ["a", "ours/A1 city 0.5", "../up", ".hidden", "50%2F", "größe|x", "東京" * 80]
)
def test_any_cell_name_comes_back(tmp_path, cell):
    write_cell(tmp_path / "results", cell, [ROW])
    assert cells(tmp_path / "results") == {cell}
    (file,) = (tmp_path / "results").iterdir()
    file.rename(file.with_name("as of another version.parquet"))
    drop_cell(tmp_path / "results", cell)
    assert cells(tmp_path / "results") == set()


def test_a_second_writing_replaces_the_first(tmp_path):
    write_cell(tmp_path, "a", [ROW, ROW])
    write_cell(tmp_path, "a", [replace(ROW, value=1.0)])
    assert read(tmp_path)["value"].tolist() == [1.0]


def test_a_truncated_cell_is_not_finished(tmp_path):
    write_cell(tmp_path, "whole", [ROW])
    file = write_cell(tmp_path, "cut", [ROW])
    file.write_bytes(file.read_bytes()[:-20])
    assert cells(tmp_path) == {"whole"}
    assert len(read(tmp_path)) == 1


def test_a_run_killed_while_writing_leaves_no_cell(tmp_path):
    kill = (
        "import os, sys; from pathlib import Path; from rlbench.benchmark import results as table;"
        "os.replace = lambda *a: os._exit(9);"
        "table.write_cell(Path(sys.argv[1]), 'a', [table.Row('r','m','c','s',1,1,0,'psnr',1.0)])"
    )
    done = subprocess.run([sys.executable, "-c", kill, tmp_path], check=False)
    assert done.returncode == 9
    assert len(os.listdir(tmp_path)) == 1  # the unfinished file did reach the disk
    assert cells(tmp_path) == set()


def test_a_cell_of_a_version_without_a_column_is_read_with_it_empty(tmp_path):
    file = write_cell(tmp_path, "a", [replace(ROW, preset="mini")])
    told = pq.read_table(file)
    pq.write_table(told.drop_columns(["preset"]), file)
    assert cells(tmp_path) == {"a"}
    assert list(read(tmp_path)["preset"]) == [""]
    assert list(read(tmp_path).columns) == list(COLUMNS)


def test_a_missing_folder_has_no_cells(tmp_path):
    assert cells(tmp_path / "none") == set()


def test_reading_a_missing_folder_says_so(tmp_path):
    with pytest.raises(TableError, match="there is no such folder"):
        read(tmp_path / "none")


def test_reading_a_folder_without_results_says_what_it_holds(tmp_path):
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(TableError, match="it holds notes.txt; rlbench run"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([], "has no rows"),
        ([replace(ROW, value=math.inf)], "value is inf"),
        ([replace(ROW, value=math.nan)], "note does not say why"),
    ],
)
def test_rows_with_a_silent_hole_are_refused(tmp_path, rows, says):
    with pytest.raises(TableError, match=says):
        write_cell(tmp_path, "a", rows)
    assert cells(tmp_path) == set()


def test_frame_of_is_what_read_gives(tmp_path):
    write_cell(tmp_path, "a", [ROW, MISSING])
    pd.testing.assert_frame_equal(to_dataframe([ROW, MISSING]), read(tmp_path))


def test_the_table_does_not_import_torch():
    names = "'torch' in sys.modules or 'pandas' in sys.modules"
    look = f"import sys, rlbench.benchmark.results; sys.exit({names})"
    assert subprocess.run([sys.executable, "-c", look], check=False).returncode == 0


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["ours"], ["ours", "ours@seed0", "ours@seed1"]),
        (["ours@seed1"], ["ours@seed1"]),
        (["ours/A2"], ["ours/A2"]),
        (["mean"], []),
    ],
)
def test_rows_of_named_weights_belong_to_their_method(names, found):
    rows = pd.DataFrame({"method": ["ours", "ours@seed0", "ours@seed1", "ours/A2", "ntas"]})
    assert list(rows[select_methods(rows, names)]["method"]) == found
