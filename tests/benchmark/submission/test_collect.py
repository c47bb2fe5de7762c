"""A submission from results: every number of the table, and no clip whose content is unknown."""

from __future__ import annotations

import shutil

import pytest

from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.results import cells, read
from rlbench.benchmark.submission.collect import collect_submission
from rlbench.benchmark.submission.current import outdated_cells
from rlbench.benchmark.submission.document import SubmissionError
from rlbench.clips.header import read_header


def test_scores_and_times_are_those_of_the_table(submitted):
    table = read(submitted.results)
    for cell in submitted.submission.measured:
        rows = table[(table["method"] == cell.method) & (table["clip"] == cell.clip)]
        rows = rows[rows["target_spp"] == cell.target_spp]
        psnr = rows[(rows["metric"] == "psnr") & (rows["frame"] >= 0)].sort_values("frame")
        assert cell.scores["psnr"] == tuple(psnr["value"])
        times = dict(zip(rows["metric"], rows["value"], strict=True))
        assert cell.method == "svgf" or cell.values["frame_ms"].value == times["frame_ms"]
        assert cell.samples == (round(cell.target_spp * 20 * 24),) * 3


def test_a_cell_without_numbers_has_its_reason(submitted):
    skipped = {(c.method, c.target_spp): c.skipped for c in submitted.submission.cells if c.skipped}
    assert skipped == {("svgf", 0.5): "supports 1 to 8 spp, requested 0.5"}


def test_a_clip_that_is_not_here_cannot_be_stated(submitted):
    table, clips = read(submitted.results), {"foyer": submitted.clips["foyer"]}
    with pytest.raises(SubmissionError, match="the clips attic are not here.*--clips"):
        collect_submission(table, submitted.results, clips)


def test_two_presets_are_two_submissions(submitted):
    table = read(submitted.results)
    table.loc[0, "preset"] = "mini"
    with pytest.raises(SubmissionError, match="of presets none, mini; a submission has one"):
        collect_submission(table, submitted.results, submitted.clips)


def test_a_metric_has_one_convention(submitted):
    table = read(submitted.results)
    table.loc[(table["metric"] == "psnr") & (table["frame"] == 1), "convention"] = "peak 255"
    with pytest.raises(SubmissionError, match="psnr under two conventions"):
        collect_submission(table, submitted.results, submitted.clips)


def test_results_of_today_are_current(submitted):
    assert outdated_cells(cells(submitted.results), submitted.clips) == []


def test_results_of_another_clip_of_the_same_name_are_outdated(submitted, tmp_path):
    other = shutil.copytree(submitted.clips["foyer"].folder, tmp_path / "foyer")
    same = dict(submitted.clips, foyer=StoredSource(other))
    assert outdated_cells(cells(submitted.results), same) == []  # pixels decide, not the folder
    shutil.copy(other / "pool.path.0000.exr", other / "pool.path.0001.exr")
    changed = dict(submitted.clips, foyer=StoredSource(other))
    outdated = outdated_cells(cells(submitted.results), changed)
    assert {key.clip for key in outdated} == {"foyer"}
    assert {key.method for key in outdated} == {"mean", "svgf"}


def test_other_code_makes_results_outdated(submitted, monkeypatch):
    monkeypatch.setattr("rlbench.registry.method_code_hash", lambda name: "0" * 16)
    assert len(outdated_cells(cells(submitted.results), submitted.clips)) == 8


def test_facts_of_a_clip_are_those_of_its_header(submitted):
    (facts,) = (clip for clip in submitted.submission.clips if clip.name == "foyer")
    header = read_header(submitted.clips["foyer"].folder)
    assert (facts.height, facts.width, facts.frames) == (20, 24, 3)
    assert facts.noise_ceiling_db == header.noise_ceiling_db
    assert facts.digests == {"path": submitted.clips["foyer"].content("path")}
