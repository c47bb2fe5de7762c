"""Work that is not done, counted: warps, decodes, calls. The page of docs/ lists every rule."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.nn import functional as F

from baselines.accumulate import method as accumulate
from baselines.mean import Mean
from baselines.svgf import history as svgf
from rlbench import registry
from rlbench.benchmark import scoring
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import RunSummary, measure
from rlbench.clips import decode_cache, stored
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.ops import surface_taps
from rlbench.run import run_clip
from tests.conftest import write_noise
from tests.measuring import measure_scores

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "concepts" / "skipping.md").read_text()
RULES = [line for line in PAGE.splitlines() if line.startswith("| ") and "tests/" in line]
WARPING = [
    name
    for name in registry.expand(["all/*"])
    if registry.get_variant(name).traits.temporal and name != "eaw/still"  # which moves no history
]


def count_calls(monkeypatch: pytest.MonkeyPatch, *functions: tuple[Any, str]) -> list[str]:
    """The names of these functions, one for each call from now on."""
    calls: list[str] = []

    def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *args, **options: (calls.append(name), function(*args, **options))[1]

    for owner, name in functions:
        monkeypatch.setattr(owner, name, counted(name, getattr(owner, name)))
    return calls


def run_plan(folder: Path, *methods: str, **options: Any) -> RunPlan:
    return RunPlan(methods, (StoredSource(folder),), **{"repeats": 1, **options})


@pytest.mark.parametrize("name", WARPING)
def test_no_method_warps_a_static_clip(name, monkeypatch):
    weights = "random" if registry.get_variant(name).learned else None
    method, warps = registry.load_method(name, torch.device("cpu"), weights), {}
    calls = count_calls(
        monkeypatch, (F, "grid_sample"), (svgf, "_sum_matching_taps"), (surface_taps, "_read")
    )
    for static in (True, False):
        clip = procedural_clip(3, Size(1, 24, 32), frames=2, static=static)
        calls.clear()
        list(run_clip(method, clip, spp=max(1.0, method.traits.min_samples)))
        warps[static] = len(calls)
    assert warps[True] == 0
    assert warps[False] > 0


def test_planning_and_denoising_share_one_reprojection(monkeypatch):
    method = registry.load_method("accumulate/contrast", torch.device("cpu"), "random")
    calls = count_calls(monkeypatch, (accumulate, "reproject_memory"))
    list(run_clip(method, procedural_clip(3, Size(1, 24, 32), frames=3), spp=1.0))
    assert len(calls) == 3


@pytest.fixture
def decoded(monkeypatch) -> Counter[tuple[str, str]]:
    """How often each channel of each file is decoded."""
    counts: Counter[tuple[str, str]] = Counter()
    read = decode_cache.read_channels

    def read_counted(path, names, *size):
        counts.update((path.name, name) for name in names)
        return read(path, names, *size)

    monkeypatch.setattr(decode_cache, "read_channels", read_counted)
    return counts


def test_all_methods_of_a_run_share_each_decoded_image(clip_folder, tmp_path, decoded):
    plan = run_plan(clip_folder, "mean", "eaw", "svgf", spp=(1.0, 2.0), seeds=(0, 1))
    assert measure(plan, tmp_path / "r").measured == 12
    assert set(decoded.values()) == {1}


def test_all_methods_of_a_run_share_what_metrics_derive_from_a_reference(
    clip_folder, tmp_path, monkeypatch
):
    read = count_calls(monkeypatch, (stored.StoredClip, "_half_reference"))
    made = count_calls(monkeypatch, (scoring, "make_ground_truth"))
    plan = run_plan(clip_folder, "mean", "eaw", spp=(1.0, 2.0), seeds=(0, 1))
    assert measure_scores(plan, tmp_path / "r").measured == 8
    assert (len(made), len(read)) == (3, 6)  # frames, and their halves


def test_a_run_decodes_no_buffer_that_no_method_or_metric_declares(clip_folder, tmp_path, decoded):
    read_by_metrics = {"motion"}
    for method, declared in (("mean", set()), ("eaw", {"albedo", "normal", "depth"})):
        measure_scores(run_plan(clip_folder, method, spp=(1.0,)), tmp_path / "r")
        views = {name.split(".")[0] for file, name in decoded if file.startswith("view")}
        assert views == declared | read_by_metrics


@pytest.mark.parametrize(("budgets", "slots"), [((0.25, 1.0), 1), ((1.0, 2.5), 3)])
def test_a_run_decodes_no_sample_above_its_largest_budget(
    clip_folder, tmp_path, decoded, budgets, slots
):
    measure_scores(run_plan(clip_folder, "mean", spp=budgets), tmp_path / "r")
    samples = [name for file, name in decoded if file.startswith("pool")]
    assert len(samples) == slots * 3 * 3  # frames; red, green and blue


def test_a_pool_of_another_kind_is_not_decoded(tmp_path, decoded):
    folder = write_noise(tmp_path / "noise")
    measure_scores(run_plan(folder, "mean", "restir", spp=(1.0,)), tmp_path / "r")
    assert {file.split(".")[1] for file, _ in decoded if file.startswith("pool")} == {"path"}


def test_a_finished_cell_runs_no_frame_and_decodes_nothing(
    clip_folder, tmp_path, decoded, monkeypatch
):
    plan = run_plan(clip_folder, "mean", spp=(1.0,))
    calls = count_calls(monkeypatch, (Mean, "denoise"))
    measure_scores(plan, tmp_path / "r")
    assert calls
    assert decoded
    calls.clear()
    decoded.clear()
    assert measure_scores(plan, tmp_path / "r") == RunSummary(cached=1)
    assert (calls, decoded) == ([], Counter())
    measure_scores(replace(plan, spp=(1.0, 2.0)), tmp_path / "r")
    assert calls  # of the new cell


def test_every_rule_of_the_page_names_code_and_a_test_that_exist():
    for rule in RULES:
        _, _, code, counted, tests, _ = rule.split("|")
        assert counted.strip()
        for path in re.findall(r"`([\w/]+\.py)`", code):
            assert (ROOT / path).is_file(), path
        named = re.findall(r"`(tests/[\w/]+\.py)::(test_\w+)`", tests)
        assert named, rule
        for file, name in named:
            assert f"def {name}(" in (ROOT / file).read_text(), name
