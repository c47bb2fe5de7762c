"""A baseline file is read, or refused with what is wrong; some ship with the package."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from rlbench.benchmark.regression.baseline import (
    BaselineError,
    find_baseline,
    load_baseline,
    shipped_baselines,
)
from rlbench.render.presets import PRESETS
from tests.benchmark.regression.examples import baseline


@pytest.mark.parametrize("name", shipped_baselines())
def test_a_shipped_baseline_is_of_the_preset_that_it_is_named_after(name):
    shipped = load_baseline(find_baseline(name))
    assert shipped.preset == name
    assert {entry.scene for entry in shipped.entries} == set(PRESETS[name].scenes)
    assert find_baseline("", name) == find_baseline(name)


def test_a_baseline_is_a_shipped_name_or_a_path():
    assert find_baseline("mine/mini.json", "mini") == Path("mine/mini.json")
    with pytest.raises(BaselineError, match="of preset paper ships; available: mini.*--update"):
        find_baseline("", "paper")
    with pytest.raises(BaselineError, match="of these clips ships"):
        find_baseline("")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "is not JSON"),
        ("[]", "has schema list, expected 3"),
        ('{"schema": 7}', "has schema 7, expected 3"),
        ('{"schema": 3}', "missing, unknown or wrong field"),
        (
            '{"schema": 3, "preset": "", "command": "", "tolerance_db": 1, "seed": 0, "speed": [], '
            '"entries": [{"a": 1}]}',
            "keys a",
        ),
    ],
)
def test_a_broken_baseline_says_what_is_wrong(tmp_path, content, message):
    (tmp_path / "b.json").write_text(content)
    with pytest.raises(BaselineError, match=message):
        load_baseline(tmp_path / "b.json")


NUMBERS = {"tolerance_db": 0.05, "target_spp": 2.0, "psnr": 30.0}
ENTRY = {"method": "ours", "scene": "city", "target_spp": 2.0, "psnr": 30.0}


def document(**changed: object) -> dict[str, object]:
    head = {
        "schema": 3,
        "preset": "mini",
        "command": "",
        "tolerance_db": 0.05,
        "seed": 0,
        "speed": [],
    }
    head |= {"entries": [ENTRY]}
    return {**head, **changed}


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
@pytest.mark.parametrize("field", NUMBERS)
def test_a_baseline_with_a_number_that_is_not_finite_is_refused(tmp_path, field, number):
    text = json.dumps(document()).replace(f'"{field}": {NUMBERS[field]}', f'"{field}": {number}')
    assert number in text
    (tmp_path / "b.json").write_text(text)
    with pytest.raises(BaselineError, match="--baseline|--update"):
        load_baseline(tmp_path / "b.json")


@pytest.mark.parametrize("number", [math.nan, math.inf, -0.1])
def test_the_gate_has_no_tolerance_that_every_score_passes(number):
    with pytest.raises(BaselineError, match="tolerance_db is .*; a finite number >= 0 is required"):
        replace(baseline(), tolerance_db=number)
    with pytest.raises(BaselineError, match="tolerance_db is .*; a finite number >= 0 is required"):
        baseline(tolerance_db=number)


@pytest.mark.parametrize("number", [math.nan, math.inf, -0.1])
def test_a_standard_error_is_a_finite_number(number):
    with pytest.raises(BaselineError, match="stderr_db is .*; a finite number >= 0 is required"):
        baseline(stderr_db=number)


@pytest.mark.parametrize("psnr", [math.nan, math.inf, -math.inf])
def test_the_gate_has_no_expected_score_that_every_score_passes(psnr):
    with pytest.raises(BaselineError, match="ours on city at 2 spp has psnr"):
        baseline(psnr)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"entries": ["x"]}, r"Expected `object`, got `str` - at `\$.entries\[0\]`"),
        ({"entries": [None]}, r"Expected `object`, got `null`"),
        ({"entries": {"a": 1}}, "Expected `array`, got `object`"),
        ({"entries": [{**ENTRY, "psnr": "30"}]}, r"Expected `float`.*entries\[0\].psnr"),
        ({"entries": [{**ENTRY, "method": 3}]}, r"Expected `str`.*entries\[0\].method"),
        ({"entries": [{**ENTRY, "target_spp": -1}]}, "target_spp is -1"),
        ({"preset": 3}, "Expected `str`, got `int`.*preset"),
        ({"tolerance_db": None}, "Expected `float`, got `null`.*tolerance_db"),
        ({"tolerance_db": -1}, "tolerance_db is -1"),
        ({"colour": 1}, "unknown keys colour"),
    ],
)
def test_a_baseline_of_wrong_types_says_which_field_and_what_to_do(tmp_path, changed, message):
    (tmp_path / "b.json").write_text(json.dumps(document(**changed)))
    with pytest.raises(BaselineError, match=f"{message}.*rlbench regress --update"):
        load_baseline(tmp_path / "b.json")


@pytest.mark.parametrize("content", [b"\xff", b'{"schema": 3, "preset": "\xe9"}', b"[" * 100_000])
def test_a_baseline_that_is_not_json_in_utf_8_is_refused(tmp_path, content):
    (tmp_path / "b.json").write_bytes(content)
    with pytest.raises(BaselineError, match="is not JSON.*Restore the file, or pass another"):
        load_baseline(tmp_path / "b.json")


def test_a_baseline_that_is_not_there_says_how_to_make_it(tmp_path):
    with pytest.raises(BaselineError, match="--update --baseline .* makes one"):
        load_baseline(tmp_path / "b.json")
