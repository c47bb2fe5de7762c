"""A baseline is read, refused with what is wrong, or rewritten from results."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from rlbench.benchmark.regression.baseline import (
    FALSE_ALARMS,
    BaselineError,
    ScoreKey,
    allowed_falls,
    find_baseline,
    load_baseline,
    shipped_baselines,
    update_baseline,
    write_baseline,
)
from rlbench.benchmark.regression.comparison import compare
from rlbench.benchmark.results import to_dataframe
from rlbench.clips.presets import PRESETS
from tests.benchmark.regression.examples import baseline, rows


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


ENTRY = {"method": "ours", "scene": "city", "target_spp": 2.0, "psnr": 30.0}


def document(**changed: object) -> bytes:
    head = {"schema": 3, "preset": "mini", "command": "", "tolerance_db": 0.05, "seed": 0}
    return json.dumps({**head, "speed": [], "entries": [ENTRY], **changed}).encode()


@pytest.mark.parametrize("number", [math.nan, math.inf, -0.1])
def test_the_gate_has_no_tolerance_and_no_expected_score_that_every_score_passes(number):
    with pytest.raises(BaselineError, match="tolerance_db is"):
        replace(baseline(), tolerance_db=number)
    with pytest.raises(BaselineError, match="tolerance_db is"):
        baseline(tolerance_db=number)
    if not math.isfinite(number):
        with pytest.raises(BaselineError, match="ours on city at 2 spp has psnr"):
            baseline(number)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "is not JSON.* pass another --baseline"),
        (b'{"schema": 3, "preset": "\xe9"}', "is not JSON"),
        (b"[" * 100_000, "is not JSON"),
        (b"[]", "schema list"),
        (b'{"schema": 7}', "schema 7"),
        (b'{"schema": 3}', "missing.*rlbench regress --update"),
        (document(tolerance_db=math.nan), "is not JSON"),
        (document(entries=[{**ENTRY, "psnr": math.inf}]), "is not JSON"),
        (document().replace(b'"target_spp": 2.0', b'"target_spp": 1e999'), "is not JSON"),
        (document(entries=["x"]), r"entries\[0\]"),
        (document(entries=[{"a": 1}]), "keys a"),
        (document(entries=[{**ENTRY, "psnr": "30"}]), r"Expected `float`.*entries\[0\].psnr"),
        (document(entries=[{**ENTRY, "target_spp": -1}]), "target_spp is -1"),
        (document(preset=3), "Expected `str`, got `int`.*preset"),
        (document(tolerance_db=None), "Expected `float`, got `null`.*tolerance_db"),
        (document(colour=1), "unknown keys colour"),
    ],
)
def test_a_broken_baseline_says_what_is_wrong(tmp_path, content, message):
    (tmp_path / "b.json").write_bytes(content)
    with pytest.raises(BaselineError, match=message):
        load_baseline(tmp_path / "b.json")


def test_a_rewritten_baseline_equals_its_results_and_keeps_its_speed_gates(tmp_path):
    table = to_dataframe(rows(30.123456) + rows(12.0, method="ntas"))
    written = update_baseline(table, tmp_path / "b.json")
    assert load_baseline(tmp_path / "b.json") == written
    assert compare(table, written).text() == "passed: 2 same"
    gated = replace(written, speed=("ours / ours/latent <= 0.9",))
    write_baseline(gated, tmp_path / "b.json")
    assert update_baseline(table, tmp_path / "b.json") == gated


def test_an_unsupported_budget_is_left_out_of_a_rewritten_baseline_and_a_crash_is_not(tmp_path):
    skipped = replace(rows(0.0, spp=0.5)[0], frame=-1, value=math.nan, note="supports 1 to 8 spp")
    table = to_dataframe([*rows(31.0), skipped])
    written = update_baseline(table, tmp_path / "b.json")
    assert [entry.target_spp for entry in written.entries] == [2.0]
    assert compare(table, written).has_passed
    crashed = replace(rows(0.0)[0], frame=-1, value=math.nan, note="RuntimeError: ...")
    with pytest.raises(BaselineError, match="no PSNR of ours on city at 2 spp"):
        update_baseline(to_dataframe([crashed, *rows(12.0, method="mean")]), tmp_path / "b.json")


def test_a_rewritten_baseline_is_of_the_smallest_seed_and_allows_what_seeds_vary_by(tmp_path):
    seeds = [rows(30.0 + 0.02 * seed, seed=seed) for seed in (1, 2, 3)]
    written = update_baseline(to_dataframe(sum(seeds, [])), tmp_path / "b.json")
    (entry,) = written.entries
    assert (written.seed, entry.psnr, entry.stderr_db, entry.frames) == (1, 30.02, 1.0, 2)
    expected = scipy.stats.t(2).isf(FALSE_ALARMS) * 0.02 * math.sqrt(2) + 0.05
    assert entry.tolerance_db == pytest.approx(expected, abs=5e-5)  # four decimals are kept
    assert load_baseline(tmp_path / "b.json") == written


def test_a_baseline_of_one_seed_keeps_the_tolerances_of_several(tmp_path):
    seeds = rows(30.0) + rows(30.1, seed=1)
    first = update_baseline(to_dataframe(seeds), tmp_path / "b.json")
    again = update_baseline(to_dataframe(rows(31.0)), tmp_path / "b.json")
    assert again.entries[0].tolerance_db == first.entries[0].tolerance_db > 0.05
    assert again.entries[0].psnr == 31.0


def test_one_method_of_a_baseline_is_rewritten_and_the_others_stay(tmp_path):
    old = update_baseline(to_dataframe(rows(30.0) + rows(12.0, method="ntas")), tmp_path / "b.json")
    table = to_dataframe(rows(31.0) + rows(9.0, method="ntas"))
    new = update_baseline(table, tmp_path / "b.json", ["ours"])
    assert new.entries == (old.entries[0], replace(old.entries[1], psnr=31.0))
    with pytest.raises(BaselineError, match="seed 0, the results of mini and 1"):
        update_baseline(to_dataframe(rows(31.0, seed=1)), tmp_path / "b.json", ["ours"])


def test_reruns_without_a_change_fail_as_rarely_as_promised():
    """300 baselines of four seeds, each with a rerun of another seed, for 4 methods x 4 scenes.

    Scenes vary by a factor of 2, as on mini. Of 300 draws at 0.05, 27 or more are alarms with
    probability 0.002 (binomial).
    """
    rng = np.random.default_rng(0)
    keys = [ScoreKey(method, str(scene), 1.0) for method in "abcd" for scene in range(4)]
    spreads = {key: 0.01 * (1 + int(key.scene) / 3) for key in keys}
    alarms = 0
    for _ in range(300):
        draws = {key: rng.normal(30.0, spreads[key], 5) for key in keys}
        by_seed = {key: draw[:4].tolist() for key, draw in draws.items()}
        falls = allowed_falls(by_seed, 0.0, len(keys))
        alarms += any(draws[key][0] - draws[key][4] > falls[key] for key in keys)
    assert alarms < 27


def test_a_cell_that_varies_more_than_its_method_is_allowed_more():
    calm, wild = ScoreKey("a", "calm", 1.0), ScoreKey("a", "wild", 1.0)
    falls = allowed_falls({calm: [20.0, 20.01, 19.99], wild: [20.0, 20.5, 19.5]}, 0.05, 2)
    assert falls[wild] > falls[calm] > 0.05
