"""The ledger of looks: one line a run and test preset, also from parallel processes."""

from __future__ import annotations

import csv
import subprocess
import sys

import pytest

from rlbench.benchmark import looks, results
from rlbench.benchmark.cell_key import CellKey
from rlbench.system.paths import WriteError
from tests.benchmark.test_runner import run_plan
from tests.conftest import write_noise
from tests.measuring import measure_scores


def cell(method="ours", preset="unseen", code="a"):
    return CellKey(f"{method}@half", "clip", 1.0, 0, "cpu", preset), code


def read(folder):
    with (folder / looks.FILE).open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_run_adds_a_line_for_each_preset_of_a_test(tmp_path):
    looks.record_looks(tmp_path, [cell(preset="train"), cell(preset="")])
    assert looks.count_looks(tmp_path) == {}
    assert not (tmp_path / looks.FILE).exists()
    looks.record_looks(tmp_path, [cell(), cell("mean", code="b"), cell(preset="mini")])
    mini, unseen = read(tmp_path)
    assert (mini["preset"], mini["methods"], mini["cells"]) == ("mini", "ours@half", "1")
    assert (unseen["preset"], unseen["methods"]) == ("unseen", "mean@half ours@half")
    assert unseen["date"].endswith("Z")
    looks.record_looks(tmp_path, [cell(preset="mini", code="changed")])
    assert looks.count_looks(tmp_path) == {"mini": 2, "unseen": 1}
    assert len({line["code_hash"] for line in read(tmp_path)}) == 3


def test_parallel_runs_lose_no_line_and_write_one_header(tmp_path):
    code = (
        "import sys; from pathlib import Path; from rlbench.benchmark import looks\n"
        "for i in range(100): looks._append(Path(sys.argv[1]), [('d', 'mini', 'm', i, 'h')])"
    )
    words = [sys.executable, "-c", code, str(tmp_path / looks.FILE)]
    processes = [subprocess.Popen(words) for _ in range(3)]
    assert [process.wait() for process in processes] == [0, 0, 0]
    assert looks.count_looks(tmp_path) == {"mini": 300}


def test_a_run_is_a_look_once_and_a_finished_one_is_none(tmp_path):
    clip = write_noise(tmp_path / "clip", preset="mini")
    for _ in range(2):
        measure_scores(run_plan(clip), tmp_path / "r")
    assert looks.count_looks(tmp_path / "r") == {"mini": 1}
    assert results.read(tmp_path / "r").attrs["looks"] == {"mini": 1}


@pytest.mark.parametrize(
    "damage",
    [
        lambda good: good.replace(b"mini", b"m\xedni"),
        lambda good: good[3:],
        lambda good: good + bytes(64) + b"\n",
        lambda good: good + b'"' + b"x" * 140_000,
    ],
)
def test_a_damaged_ledger_counts_nothing_and_the_next_run_sets_it_aside(tmp_path, damage):
    looks.record_looks(tmp_path, [cell(preset="mini")])
    damaged = damage((tmp_path / looks.FILE).read_bytes())
    (tmp_path / looks.FILE).write_bytes(damaged)
    assert looks.count_looks(tmp_path) == {}
    looks.record_looks(tmp_path, [cell()])
    assert looks.count_looks(tmp_path) == {"unseen": 1}
    assert (tmp_path / "looks.csv.damaged").read_bytes() == damaged


def test_nothing_is_written_through_a_link_in_place_of_the_ledger(tmp_path):
    (tmp_path / "notes").write_text("precious")
    (tmp_path / looks.FILE).symlink_to("notes")
    looks.record_looks(tmp_path, [cell()])
    assert (tmp_path / "notes").read_text() == "precious"
    assert looks.count_looks(tmp_path) == {"unseen": 1}


def test_a_folder_that_takes_no_file_is_an_error_that_names_it(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match=r"looks\.csv cannot be written"):
        looks.record_looks(tmp_path / "file", [cell()])
