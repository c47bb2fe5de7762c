"""The file of a submission: what is written is read, and what is no submission is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from rlbench.benchmark.submission.document import (
    SubmissionError,
    content_hash,
    read_submission,
    write_submission,
)


@pytest.fixture
def file(submitted, tmp_path):
    path = tmp_path / "a.rlbench.json"
    write_submission(submitted.submission, path)
    return path


def test_what_is_read_is_what_was_written(submitted, file):
    assert read_submission(file) == submitted.submission


def test_equal_content_gives_equal_bytes(submitted, file, tmp_path):
    write_submission(read_submission(file), tmp_path / "b.json")
    assert (tmp_path / "b.json").read_bytes() == file.read_bytes()


def test_the_hash_ignores_layout_and_covers_every_field(submitted, file):
    file.write_text(json.dumps(json.loads(file.read_text()), indent=7, sort_keys=True))
    submission = read_submission(file)
    assert content_hash(submission) == submission.content_hash
    for change in ({"note": "x"}, {"licence": "MIT"}, {"cells": submission.cells[1:]}):
        assert content_hash(replace(submission, **change)) != submission.content_hash


def test_a_cell_is_one_line(submitted, file):
    lines = [line for line in file.read_text().splitlines() if '"method": ' in line]
    assert len(lines) == len(submitted.submission.cells) == 8
    assert all(json.loads(line.strip().removesuffix(",")) for line in lines)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": 9}, "has schema 9, this version reads 1"),
        ({"licence": 5}, r"Expected `str`, got `int` - at `\$.licence`"),
        ({"bonus": 1}, "unknown fields bonus"),
        ({"note": "\x1b[2J"}, "control characters"),
        ({"clips": [{"name": "x"}]}, "missing required field"),
    ],
)
def test_a_file_that_is_no_submission_says_what_is_wrong(file, change, message):
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
    with pytest.raises(SubmissionError, match=message):
        read_submission(file)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("cells", {"target_spp": -1}, "a budget is 0 to 65536 spp"),
        ("cells", {"target_spp": 1e308}, "a budget is 0 to 65536 spp"),
        ("cells", {"speed": 3}, "cells: unknown fields speed"),
        ("clips", {"height": 10**9}, "height, width and frames are 1 to 65536"),
        ("clips", {"noise_ceiling_db": [-1e9]}, "a noise ceiling is 0 to 200 dB"),
    ],
)
def test_numbers_that_no_run_has_are_refused_when_they_are_read(file, name, change, message):
    document = json.loads(file.read_text())
    document[name][0] |= change
    file.write_text(json.dumps(document))
    with pytest.raises(SubmissionError, match=message):
        read_submission(file)


def test_nan_is_no_json_and_no_score(file):
    file.write_text(file.read_text().replace('"seed": 0', '"seed": NaN', 1))
    with pytest.raises(SubmissionError, match="is not JSON"):
        read_submission(file)
