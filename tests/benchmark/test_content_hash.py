"""Identities of cells: what changes their hashes, and which stored cells a cell replaces."""

from __future__ import annotations

import shutil
from dataclasses import replace

import pytest

from rlbench import registry
from rlbench.apps.render import clock
from rlbench.benchmark import latency
from rlbench.benchmark.cell_key import (
    FAILED,
    CellId,
    CellKey,
    CellsError,
    by_slot,
    check_no_overwrite,
    superseded_cells,
)
from rlbench.benchmark.content_hash import CellIds
from rlbench.benchmark.run_plan import RunPlan, list_cells
from rlbench.clips.header import read_header, write_header
from rlbench.system import provenance
from tests.benchmark.test_runner import change_code, requires, run_plan, use_changed_plugin
from tests.conftest import write_noise, write_plugin


def cell_ids(plan: RunPlan) -> list[CellId]:
    ids = CellIds(plan)
    return [ids.cell_id(cell) for cell in list_cells(plan)]


def test_another_sample_time_of_a_pool_is_another_cell(tmp_path):
    """A profile has path samples only; others cost their measured multiple of them."""
    ids = set()
    for price in (4.0, 8.0):
        pools = {"pools": ("path", "restir"), "pools_ms": (2.0, price)}
        folder = write_noise(tmp_path / "noise", **pools)
        for file in folder.glob("pool.path.*"):
            shutil.copy(file, folder / file.name.replace("path", "restir"))
        plan = run_plan(folder, "restir", "mean", cost="paper-2080ti")
        ids |= set(cell_ids(plan))
    assert sorted(cell.key.method for cell in ids) == ["mean", "restir", "restir"]


@pytest.mark.parametrize(
    "line",
    [
        "from helpers import net",
        "try:\n    from .net import WIDTH\nexcept ImportError:\n    pass",
        "try:\n    from torn import WIDTH\nexcept ZeroDivisionError:\n    pass",
    ],
)
def test_a_plugin_file_has_a_hash_whatever_it_imports(clip_folder, tmp_path, monkeypatch, line):
    monkeypatch.syspath_prepend(tmp_path)
    for folder, text in (("helpers", "net"), ("torn", "__init__")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / f"{text}.py").write_text("1 / 0" if folder == "torn" else "WIDTH = 4")
    plugin = write_plugin(tmp_path / "odd.py", "odd")
    plugin.write_text(f"{line}\n{plugin.read_text()}")
    registry.use_plugin(plugin)
    first = CellIds(run_plan(clip_folder, "odd")).code_hashes["odd"]
    (tmp_path / "helpers" / "net.py").write_text("WIDTH = 8")
    changed = CellIds(run_plan(clip_folder, "odd")).code_hashes["odd"]
    assert len(first) == len(changed) == 16
    assert (first != changed) == ("helpers" in line)


def test_samples_are_charged_again_on_another_machine(clip_folder, monkeypatch):
    plan, ids = run_plan(clip_folder), set()
    monkeypatch.setattr(latency, "device_name", lambda device: "gpu")
    for cores in (2, 16):
        here = provenance.Machine("cpu", cores, "gpu", "os")
        monkeypatch.setattr(provenance, "machine", lambda here=here: here)
        ids |= set(cell_ids(plan))
    assert len(ids) == 2


@pytest.mark.parametrize(
    ("module", "has_new_scores"),
    [
        ("rlbench.apps.render.jobs.live_pool", False),  # measures scattered samples
        ("rlbench.apps.render.mitsuba.tracer", False),
        ("rlbench.benchmark.scoring", True),  # makes the ground truth
        ("rlbench.ops.dither", True),
        ("baselines.oidn.method", True),
        ("methods.ours.accumulators", True),
    ],
)
def test_new_code_measures_scores_again_or_times_alone(
    clip_folder, monkeypatch, module, has_new_scores
):
    plan = run_plan(clip_folder, "ours")
    (before,) = cell_ids(plan)
    change_code(monkeypatch, module)
    (after,) = cell_ids(plan)
    assert after.has_scores_of(before) != has_new_scores
    assert has_new_scores or after.times_hash != before.times_hash


def fail() -> str:
    raise ImportError("no tracer")


@pytest.mark.parametrize("is_local", [False, True])
def test_samples_that_are_traced_here_are_timed_again_by_another_tracer_or_scene(
    tmp_path, monkeypatch, is_local
):
    device = provenance.machine().name if is_local else "another machine"
    plan = run_plan(write_noise(tmp_path / "noise", scene="temple", device=device))
    ids = []
    for describe in (fail, lambda: "1 thread", lambda: "2 threads", lambda: "2 threads"):
        monkeypatch.setattr(clock, "describe_tracer", describe)
        ids += cell_ids(plan)
    change_code(monkeypatch, registry.list_entries("scenes")["temple"].target.partition(":")[0])
    ids += cell_ids(plan)
    none, one, two, again, changed = ids
    assert all(each.has_scores_of(none) and each.times_hash for each in ids)
    assert two == again
    assert len({none, one, two, changed}) == (1 if is_local else 4)


@pytest.mark.parametrize("package", ["openvino", "numpy"])
def test_another_version_of_a_backend_or_a_package_scores_again(
    clip_folder, tmp_path, monkeypatch, package
):
    use_changed_plugin(tmp_path, requires("numpy"))
    plan, ids = run_plan(clip_folder, "oidn" if package == "openvino" else "odd"), []
    for version in ({package: "1"}, {package: "2"}):
        monkeypatch.setattr(provenance, "_version", lambda name, known=version: known.get(name, ""))
        ids += cell_ids(replace(plan, backend="openvino"))
    assert not ids[0].has_scores_of(ids[1])


def test_other_content_of_shipped_weights_scores_again(clip_folder, tmp_path, monkeypatch):
    """`oidn` once had the weights of today's `oidn/retrained`: scores of the two never mix."""
    weights, ids = tmp_path / "oidn.safetensors", []
    monkeypatch.setattr(registry, "shipped_weights", lambda name: weights)
    for content in ("former", "of today"):
        weights.write_text(content)
        ids += cell_ids(run_plan(clip_folder, "oidn"))
    assert not ids[0].has_scores_of(ids[1])


@pytest.mark.parametrize(
    "field", [{"cuts": (1,)}, {"light_changes": (2,)}, {"noise_ceiling_db": (40.0, 41.0, 42.0)}]
)
def test_events_and_ceilings_that_a_clip_gets_later_score_again(clip_folder, field):
    plan = run_plan(clip_folder)
    (before,) = cell_ids(plan)
    write_header(clip_folder, replace(read_header(clip_folder), **field))
    (after,) = cell_ids(run_plan(clip_folder))
    assert not after.has_scores_of(before)


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
