"""The results table: written cells are read back, unfinished ones are not there."""

from __future__ import annotations

import math
import os
import re
import struct
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rlbench.benchmark.cell_key import CellId, CellKey
from rlbench.benchmark.results import (
    COLUMNS,
    Row,
    RowName,
    RowOptions,
    TableError,
    cells,
    drop_cell,
    read,
    select_methods,
    set_aside_damaged,
    to_dataframe,
    write_cell,
)

ROW = Row("r", "ours/A1", "city-0", "city", 2.0, 1.99, 0, "psnr", 31.25, "dB", "higher", "sRGB")

MISSING = replace(ROW, frame=-1, value=math.nan, note="needs CUDA")

KEY = CellKey("ours/A1", "city-0", 2.0, 0, "a CPU, 2 threads")

A, B = CellId(KEY, "a"), CellId(KEY, "b")


def test_what_is_written_is_read_back(tmp_path):
    write_cell(tmp_path, A, [ROW, replace(ROW, frame=1, value=1 / 3)])
    assert read(tmp_path).to_dict("records") == [
        asdict(ROW),
        asdict(ROW) | {"frame": 1, "value": 1 / 3},
    ]


@pytest.mark.parametrize(
    "name", ["a", "ours/A1 city 0.5", "../up", ".hidden", "50%2F", "größe|x", "東京" * 80]
)
def test_any_name_comes_back(tmp_path, name):
    cell = CellId(replace(KEY, method=name, clip=name, device=name, preset=name), "a")
    write_cell(tmp_path / "results", cell, [ROW])
    assert cells(tmp_path / "results") == {cell}
    (file,) = (tmp_path / "results").iterdir()
    file.rename(file.with_name("as of another version.parquet"))
    drop_cell(tmp_path / "results", cell)
    assert cells(tmp_path / "results") == set()


def rewrite(file: Path, table: pa.Table) -> None:
    """Write a changed table with the checksum of the former one."""
    write_identity(file, table, pq.read_schema(file).metadata[b"rlbench"])


def write_identity(file: Path, table: pa.Table, identity: bytes) -> None:
    pq.write_table(table.replace_schema_metadata({b"rlbench": identity}), file)


def with_column(table: pa.Table, name: str, values: list[object]) -> pa.Table:
    return table.set_column(table.column_names.index(name), name, pa.array(values))


NO_TEXT = pa.array([None], pa.string())


DAMAGES = {
    "is cut short": lambda file, table: file.write_bytes(file.read_bytes()[:-20]),
    "is empty": lambda file, table: file.write_bytes(b""),
    "has a flipped byte in a number": lambda file, table: file.write_bytes(
        file.read_bytes().replace(struct.pack("<d", 31.25), struct.pack("<d", 31.26))
    ),
    "has another seed in its identity": lambda file, table: write_identity(
        file, table, table.schema.metadata[b"rlbench"].replace(b'"seed": 0', b'"seed": 1')
    ),
    "has another value": lambda file, table: rewrite(file, with_column(table, "value", [99.0])),
    "has no identity": lambda file, table: pq.write_table(table.replace_schema_metadata({}), file),
    "has no JSON": lambda file, table: write_identity(file, table, b"\xff{"),
    "has wrong types": lambda file, table: write_identity(file, table, b'{"schema": 2, "key": 3}'),
    "has text for values": lambda file, table: rewrite(file, with_column(table, "value", ["x"])),
    "has fractions": lambda file, table: rewrite(file, with_column(table, "frame", [0.5])),
    "has a gap": lambda file, table: rewrite(file, with_column(table, "clip", NO_TEXT)),
    "lacks a column": lambda file, table: rewrite(file, table.drop_columns(["metric"])),
    "has no rows": lambda file, table: rewrite(file, table.slice(0, 0)),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_file_is_an_error_that_names_it_and_is_set_aside_if_it(tmp_path, damage):
    write_cell(tmp_path, A, [ROW])
    file = write_cell(tmp_path, B, [ROW])
    before = file.read_bytes()
    damage(file, pq.read_table(file))
    assert file.read_bytes() != before
    name = re.escape(str(file))
    with pytest.raises(TableError, match=f"{name} is damaged: .*Repeat the rlbench run"):
        read(tmp_path)
    damaged = file.read_bytes()
    (renamed,) = set_aside_damaged(tmp_path)
    assert (renamed.name, renamed.read_bytes()) == (f"{file.name}.damaged", damaged)
    assert cells(tmp_path) == {A}
    assert read(tmp_path).to_dict("records") == [asdict(ROW)]
    assert set_aside_damaged(tmp_path) == []


def test_a_parquet_file_of_other_content_is_no_cell_and_stays(tmp_path):
    write_cell(tmp_path, A, [ROW])
    pq.write_table(pa.table({"colour": ["red"]}), tmp_path / "notes.parquet")
    assert set_aside_damaged(tmp_path) == []
    assert len(read(tmp_path)) == 1
    assert cells(tmp_path) == {A}


def test_a_run_killed_while_writing_leaves_no_cell(tmp_path):
    kill = (
        "import os, sys; from pathlib import Path; from rlbench.benchmark import results;"
        "from rlbench.benchmark.cell_key import CellId, CellKey;"
        "os.replace = lambda *a: os._exit(9);"
        "cell = CellId(CellKey('m', 'c', 1.0, 0, 'cpu'), 'a');"
        "rows = [results.Row('r', 'm', 'c', 's', 1, 1, 0, 'psnr', 1.0)];"
        "results.write_cell(Path(sys.argv[1]), cell, rows)"
    )
    done = subprocess.run([sys.executable, "-c", kill, tmp_path], check=False)
    assert done.returncode == 9
    assert len(os.listdir(tmp_path)) == 1  # the unfinished file did reach the disk
    assert cells(tmp_path) == set()


@pytest.mark.parametrize(("newest", "is_short"), [(A, False), (B, True)])
def test_of_two_versions_of_a_cell_that_a_kill_left_the_newest_is_read(tmp_path, newest, is_short):
    older = A if newest is B else B
    older = replace(older, key=replace(KEY, first_frames_only=is_short))
    files = [
        write_cell(tmp_path, older, [ROW, replace(ROW, frame=1)]),
        write_cell(tmp_path, newest, [replace(ROW, value=1.0)]),
    ]
    for seconds, file in enumerate(files):
        os.utime(file, (seconds, seconds))
    assert read(tmp_path)["value"].tolist() == [1.0]
    for file in files:  # of equal age, one is read
        os.utime(file, (9, 9))
    assert len(read(tmp_path)) in (1, 2)
    assert read(tmp_path).equals(read(tmp_path))


FIELDS = {"method": "x", "clip": "x", "target_spp": 4.0, "seed": 1, "preset": "x", "metric": "x"}


@pytest.mark.parametrize(("name", "value"), FIELDS.items())
def test_cells_that_differ_in_what_was_measured_are_all_read_in_order_of_their_files(
    tmp_path, name, value
):
    others = [write_cell(tmp_path, B, [replace(ROW, value=2.0)])]
    others.append(
        write_cell(tmp_path, CellId(replace(KEY, **{name: value}), "b"), [replace(ROW, value=1.0)])
    )
    values = dict(zip(others, (2.0, 1.0), strict=True))
    assert read(tmp_path)["value"].tolist() == [values[file] for file in sorted(values)]


def test_a_newer_schema_is_an_error(tmp_path):
    file = write_cell(tmp_path, A, [ROW])
    identity = pq.read_schema(file).metadata[b"rlbench"].replace(b'"schema": 2', b'"schema": 3')
    write_identity(file, pq.read_table(file), identity)
    with pytest.raises(TableError, match=r"schema 3, this version reads 2. Update rlbench"):
        cells(tmp_path)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([], "has no rows"),
        ([replace(ROW, value=math.inf)], "value is inf"),
        ([replace(ROW, value=math.nan)], "note does not say why"),
    ],
)
def test_values_that_are_missing_without_a_reason_are_refused(tmp_path, rows, says):
    with pytest.raises(TableError, match=says):
        write_cell(tmp_path, A, rows)
    assert cells(tmp_path) == set()


def test_to_dataframe_equals_read_and_has_the_documented_types(tmp_path):
    write_cell(tmp_path, A, [MISSING])  # a second writing replaces the first
    write_cell(tmp_path, A, [ROW, MISSING])
    pd.testing.assert_frame_equal(to_dataframe([ROW, MISSING]), read(tmp_path))
    kinds = {name: dtype.kind for name, dtype in read(tmp_path).dtypes.items()}
    numbers = {"frame": "i", "seed": "i", "target_spp": "f", "mean_spp": "f", "value": "f"}
    assert {name: kinds[name] for name in numbers} == numbers
    assert tuple(kinds) == COLUMNS


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["ours"], ["ours", "ours@seed0", "ours@seed1"]),
        (["ours@seed1"], ["ours@seed1"]),
        (["ours/A2"], ["ours/A2"]),
        (["mean"], []),
    ],
)
def test_rows_with_a_label_belong_to_their_method(names, expected):
    rows = pd.DataFrame({"method": ["ours", "ours@seed0", "ours@seed1", "ours/A2", "ntas"]})
    assert list(rows[select_methods(rows, names)]["method"]) == expected


@pytest.mark.parametrize(
    ("text", "parts", "options"),
    [
        ("ours", ("ours", "", ""), RowOptions()),
        ("ours/A2", ("ours", "A2", ""), RowOptions()),
        ("mean@tiles", ("mean", "", "tiles"), RowOptions(skip_tiles=True)),
        (
            "ours@compile-half-tiles",
            ("ours", "", "compile-half-tiles"),
            RowOptions("compile", half=True, skip_tiles=True),
        ),
        (
            "ours/A2@half-seed-3",
            ("ours", "A2", "half-seed-3"),
            RowOptions(half=True, weights="seed-3"),
        ),
        ("ours@weights-half", ("ours", "", "weights-half"), RowOptions(weights="weights-half")),
        ("restir+oidn@crossval", ("restir+oidn", "", "crossval"), RowOptions(weights="crossval")),
    ],
)
def test_a_name_is_parsed_as_it_is_printed_and_its_label_says_how_it_ran(text, parts, options):
    assert RowName.parse(text) == RowName(*parts)
    assert str(RowName(*parts)) == text
    assert RowName.parse(text).method_name == text.partition("@")[0]
    assert RowName.parse(text).options == options
