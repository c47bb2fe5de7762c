"""Identity of cells: which stored cells a cell replaces, and which it must not replace."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rlbench.benchmark.cell_key import (
    FAILED,
    CellId,
    CellKey,
    CellsError,
    by_slot,
    check_no_overwrite,
    superseded_cells,
)

KEY = CellKey("ours/A2@seed0", "city", 0.5, 1, "a CPU, 2 threads", "mini")
STORED = CellId(KEY, "old")


@pytest.mark.parametrize(
    "changes",
    [{"method": "ours/A2"}, {"clip": "hall"}, {"target_spp": 1.0}, {"seed": 0}, {"device": "GPU"}],
)
def test_a_cell_of_another_slot_stays(changes):
    new = CellId(replace(KEY, **changes), "new")
    assert superseded_cells(new, by_slot([STORED])) == set()


def test_a_cell_replaces_all_others_of_its_slot():
    new, other = CellId(KEY, "new"), CellId(replace(KEY, first_frames_only=True), "other")
    assert superseded_cells(new, by_slot([STORED, other, new])) == {STORED, other}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"preset": "large"}, "seed 1' exist for preset mini .* by preset large, .*another --out"),
        ({"preset": ""}, "exist for preset mini and would be overwritten by no preset"),
        ({"first_frames_only": True}, "for the whole clip .*--limit-frames.*Use another --out"),
    ],
)
def test_scores_that_would_be_lost_are_an_error(changes, message):
    new = CellId(replace(KEY, **changes), "new")
    with pytest.raises(CellsError, match=f"'ours/A2@seed0 on city at 0.5 spp, .*{message}"):
        check_no_overwrite(new, by_slot([STORED]))
    check_no_overwrite(new, by_slot([CellId(KEY, FAILED)]))  # which holds no scores
    if "first_frames_only" in changes:  # a whole clip may replace its first frames
        check_no_overwrite(STORED, by_slot([new]))


def test_file_names_are_readable_and_differ_with_every_field():
    ids = [STORED, CellId(KEY, "new")]
    ids += [CellId(replace(KEY, **{name: "x"}), "old") for name in ("device", "preset")]
    stems = [cell.file_stem for cell in ids]
    assert len(set(stems)) == len(stems)
    assert {stem.rpartition(" ")[0] for stem in stems} == {"ours-A2@seed0 city 0.5spp seed1"}
