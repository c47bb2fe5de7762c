"""Measuring a plan: cells, resuming, replacing, and reasons of cells that cannot run."""

from __future__ import annotations

import math
import re
import shutil
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metrics.metric import Metric
from rlbench import registry
from rlbench.benchmark import results as table
from rlbench.benchmark import runner
from rlbench.benchmark.cell_key import CellsError
from rlbench.benchmark.clip_sources import StoredSource, max_samples_needed
from rlbench.benchmark.run_plan import CellLoader, RunPlan, row_name
from rlbench.benchmark.runner import RunSummary, measure, read_cells
from rlbench.clips.stored import open_clip
from rlbench.system import code_hash
from rlbench.system.paths import WriteError
from tests.conftest import write_noise, write_plugin
from tests.measuring import measure_scores

MS = "_ms"  # end of the names of times, which differ between runs


def run_plan(folder: Path, *methods: str, **options: object) -> RunPlan:
    defaults = {"spp": (1.0,), "repeats": 2}
    return RunPlan(methods or ("mean",), (StoredSource(folder),), **{**defaults, **options})


def change_code(monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    """Let a module have another code hash."""
    sources = code_hash._sources

    def changed(name: str) -> list[tuple[str, Path]]:
        files = sources(name)
        return [(f"{file}, changed", path) for file, path in files] if name == module else files

    monkeypatch.setattr(code_hash, "_sources", changed)


def scores(results: Path) -> list[tuple]:
    """All rows but times and what the clock says of them, without the run id."""
    rows = table.read(results)
    is_time = rows["metric"].str.endswith(MS) | rows["metric"].str.startswith(table.CLOCK_PREFIX)
    untimed = rows[~is_time].drop(columns="run_id")
    return sorted(untimed.itertuples(index=False, name=None), key=repr)


def reasons(results: Path) -> list[str]:
    """All notes but those of a busy machine, and of samples of another device."""
    notes = set(table.read(results)["note"]) - {""}
    return sorted(n for n in notes if not n.startswith((table.UNCERTAIN, table.TWO_DEVICES)))


def _files(folder: Path) -> dict[str, int]:
    return {file.name: file.stat().st_mtime_ns for file in folder.iterdir()}


def _srgb(linear: np.ndarray) -> np.ndarray:
    x = linear.clip(0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def use_changed_plugin(folder: Path, changes: dict[str, str]) -> None:
    """Use a plugin `odd` in which pieces of code are replaced."""
    plugin = write_plugin(folder / "odd.py", "odd")
    text = plugin.read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    plugin.write_text(text)
    registry.use_plugin(plugin)


def use_method_that_needs_a_file(folder: Path) -> Path:
    """The file without which the plugin `odd` fails."""
    body = f"open({str(folder / 'file')!r}); return samples.mean, None"
    registry.use_plugin(write_plugin(folder / "odd.py", "odd", body=body))
    (folder / "file").touch()
    return folder / "file"


def test_every_frame_has_a_row_of_every_metric(tmp_path):
    folder = write_noise(tmp_path / "large", h=176, w=176, frames=3)  # MS-SSIM needs 161
    assert measure_scores(run_plan(folder), tmp_path / "r") == RunSummary(measured=1)
    rows = table.read(tmp_path / "r")
    scored = set(zip(rows["frame"], rows["metric"], strict=True))
    assert {(f, m) for f, m in scored if f >= 0} == {
        (frame, metric)
        for frame in range(3)
        for metric, scorer in registry.load_run_metrics().items()
        if frame >= scorer.previous_frames
    }


def test_the_histogram_of_counts_spends_the_budget_and_its_cap_is_that_of_the_clip(
    clip_folder, tmp_path
):
    measure_scores(run_plan(clip_folder, spp=(0.5, 8.0)), tmp_path / "r")
    table_rows = table.read(tmp_path / "r")
    rows = table_rows[table_rows["metric"].str.startswith(table.COUNT_PREFIX)]
    spp = rows["metric"].str.removeprefix(table.COUNT_PREFIX).astype(int)
    by_budget = rows.assign(spent=spp * rows["value"] / 100).groupby("target_spp")
    assert by_budget["value"].sum().to_dict() == pytest.approx({0.5: 100, 8.0: 100})
    assert by_budget["spent"].sum().to_dict() == pytest.approx({0.5: 0.5, 8.0: 8.0})
    assert sorted(spp.unique()) == list(range(9))  # of 8 stored samples
    shares = table_rows[table_rows["metric"] == "at_cap"].groupby("target_spp")["value"].mean()
    assert shares.to_dict() == {0.5: 0.0, 8.0: 100.0}  # not of what a uniform method reads


def test_the_counts_of_a_frame_are_let_go_before_the_end_of_the_clip(tmp_path, monkeypatch):
    kept, run_clip = [], runner.run_clip

    def watched(*arguments):
        counts = []
        for result in run_clip(*arguments):
            counts.append(weakref.ref(result.samples.counts))
            yield result
            del result
        kept.append(sum(each() is not None for each in counts))

    monkeypatch.setattr(runner, "run_clip", watched)
    measure_scores(run_plan(write_noise(tmp_path / "noise", frames=8)), tmp_path / "r")
    assert kept[0] <= 3  # of the frame and of the two before, which metrics read


def test_a_metric_reads_motion_that_its_method_does_not_receive(tmp_path, monkeypatch):
    moved = Metric("moved", "px", "", "x", lambda c: c.motion[:, 0].mean((1, 2)), needs=("motion",))
    monkeypatch.setattr(registry, "load_run_metrics", lambda: {"psnr": moved})
    body = "assert not gbuffer.buffers\n        return samples.mean, None"
    registry.use_plugin(write_plugin(tmp_path / "blind.py", "blind", body=body))
    folder = write_noise(tmp_path / "noise", frames=1)
    assert measure_scores(run_plan(folder, "blind"), tmp_path / "r") == RunSummary(measured=1)
    rows = table.read(tmp_path / "r")
    (frame,) = open_clip(folder)
    expected = float(frame.gbuffer.motion[:, 0].mean())
    assert rows[rows["metric"] == "moved"]["value"].tolist() == pytest.approx([expected])


def test_psnr_of_the_mean_is_that_of_numpy(clip_folder, tmp_path):
    measure_scores(run_plan(clip_folder, spp=(8.0,)), tmp_path / "r")
    rows = table.read(tmp_path / "r")
    psnr = rows[(rows["metric"] == "psnr") & (rows["frame"] == 1)]["value"].item()

    frame = list(open_clip(clip_folder))[1]
    image, truth = (
        _srgb(image[0].numpy().astype(np.float64))
        for image in (frame.pool.radiance.mean(1), frame.reference.mean)
    )
    # float32 sums of eight samples
    assert psnr == pytest.approx(-10 * math.log10(((image - truth) ** 2).mean()), abs=1e-3)


def test_new_times_leave_scores_bit_identical_and_score_no_frame(
    clip_folder, tmp_path, monkeypatch
):
    plan = run_plan(clip_folder, "mean", "eaw", spp=(0.5, 2.0))
    measure(plan, tmp_path / "r")
    before, runs = scores(tmp_path / "r"), table.read(tmp_path / "r")
    with monkeypatch.context() as patched:
        patched.setattr("rlbench.benchmark.runner.score_frames", None)  # calling it would fail
        done = measure(plan, tmp_path / "r", times="again")
    assert done == RunSummary(timed=3, skipped=1)  # eaw does not support 0.5 spp
    assert repr(scores(tmp_path / "r")) == repr(before)  # as text, since nan differs from nan
    after = table.read(tmp_path / "r")
    assert list(after["metric"]) == list(runs["metric"])
    assert list(after["value"]) != list(runs["value"])
    assert measure(plan, tmp_path / "r") == RunSummary(cached=4)


def test_only_uncertain_times_are_measured_again(clip_folder, tmp_path):
    plan, folder = run_plan(clip_folder, "mean", "eaw"), tmp_path / "r"
    measure(plan, folder)
    for cell in table.cells(folder):
        note = f"{table.UNCERTAIN} busy" if cell.key.method == "mean" else ""
        rows = [row for row in table.read_cell_rows(folder, cell) if math.isfinite(row.value)]
        noted = [replace(row, note=note if row.unit == "ms" else row.note) for row in rows]
        table.write_cell(folder, cell, noted)
    assert measure(plan, folder, times="uncertain") == RunSummary(timed=1, cached=1)


def test_a_run_without_times_leaves_them_to_a_later_run(clip_folder, tmp_path, monkeypatch):
    plan = run_plan(clip_folder, "mean", "eaw", spp=(0.5, 2.0))
    with monkeypatch.context() as patched:
        patched.setattr("rlbench.benchmark.latency.time_methods", None)  # calling it would fail
        done = measure_scores(plan, tmp_path / "r")
        assert done == RunSummary(measured=3, skipped=1)  # eaw does not support 0.5 spp
        assert measure_scores(plan, tmp_path / "r") == RunSummary(cached=4)
    rows, before = table.read(tmp_path / "r"), scores(tmp_path / "r")
    assert "ms" not in set(rows["unit"])
    assert measure(plan, tmp_path / "r") == RunSummary(timed=3, skipped=1)
    assert repr(scores(tmp_path / "r")) == repr(before)
    timed = table.read(tmp_path / "r")
    assert "frame_ms" in set(timed["metric"])
    changed = replace(plan, cost="paper-2080ti")  # whose times would be others
    assert measure_scores(changed, tmp_path / "r") == RunSummary(cached=4)
    assert table.read(tmp_path / "r").equals(timed)


def test_a_damaged_row_file_is_set_aside_and_its_cell_is_measured_again(clip_folder, tmp_path):
    plan = run_plan(clip_folder, spp=(1.0, 2.0, 3.0))
    measure_scores(plan, tmp_path / "r")
    before, files = scores(tmp_path / "r"), _files(tmp_path / "r")
    damaged, *others = sorted((tmp_path / "r").glob("*.parquet"))
    damaged.write_bytes(damaged.read_bytes()[:-20])
    done = measure_scores(plan, tmp_path / "r")
    assert done == RunSummary(measured=1, cached=2)
    assert [file.name for file in done.set_aside] == [f"{damaged.name}.damaged"]
    assert scores(tmp_path / "r") == before
    assert {f.name: files[f.name] for f in others}.items() <= _files(tmp_path / "r").items()


def test_a_stopped_run_resumes_and_ends_as_an_undisturbed_one(clip_folder, tmp_path):
    plan = run_plan(clip_folder, spp=(0.5, 1.0, 2.0))

    def stop(cell):
        if cell.spp == 1.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        measure_scores(plan, tmp_path / "r", stop)
    assert measure_scores(plan, tmp_path / "r") == RunSummary(measured=1, cached=2)
    measure_scores(plan, tmp_path / "undisturbed")
    assert scores(tmp_path / "r") == scores(tmp_path / "undisturbed")


SHAPE, DTYPE = "samples.mean[:, :1]", "samples.mean.half()"

NAN = {"body": "return samples.mean * float('nan'), None"}


@pytest.mark.parametrize(
    ("plugin", "header", "spp", "reason"),
    [
        ({"traits": "spp_range=(1.0, 4.0)"}, {}, 8.0, "1 to 4 spp.* 8"),
        ({"traits": "pool='odd'"}, {}, 1.0, "'odd' pool"),
        ({"traits": "inputs=frozenset({'depth'})"}, {"buffers": ("albedo",)}, 1.0, "depth"),
        ({}, {"pool_spp": 4}, 8.0, "8 spp .*4 samples"),
        ({"body": "raise RuntimeError('no luck')"}, {}, 1.0, "RuntimeError: no luck"),
        ({"body": f"return {SHAPE}, None"}, {}, 1.0, r"WrongReturnError: .*\(odd.py:\d+\)"),
        ({"body": f"return {DTYPE}, None"}, {}, 1.0, "PluginError: 'odd' .*torch.float16"),
        ({"body": "raise SystemExit(0)"}, {}, 1.0, r"PluginExitError: .* called sys.exit\(0\)"),
        ({"build": "raise OSError('no weights')"}, {}, 1.0, "OSError: no weights"),
        (NAN, {}, 1.0, None),  # scored as errors, not skipped
    ],
)
def test_a_cell_that_cannot_run_is_one_row_with_the_reason(tmp_path, plugin, header, spp, reason):
    registry.use_plugin(write_plugin(tmp_path / "odd.py", "odd", **plugin))
    folder = write_noise(tmp_path / "clip", **header)
    done = measure(run_plan(folder, "odd", spp=(spp,), cost="paper-2080ti"), tmp_path / "r")
    is_error = "Error: " in (reason or "")
    counts = {"failed": 1} if is_error else {"skipped": 1} if reason else {"measured": 1}
    assert done == RunSummary(**counts)
    assert [str(cell) for cell in done.failures] == ["odd on clip at 1 spp, seed 0"] * is_error
    (note,) = reasons(tmp_path / "r")
    assert re.search(reason or "^the profile's default, as it has no 'noise'$", note)
    if reason:
        (row,) = table.read(tmp_path / "r").itertuples()
        assert (row.frame, row.metric, math.isnan(row.value)) == (-1, "psnr", True)


NO_CODE = {'"odd:build"': '"nowhere.at.all:build"'}

LEARNED = {"learned=False": "learned=True"}


def requires(package: str) -> dict[str, str]:
    """What lets a plugin need a package."""
    return {"learned=False": f"learned=False, requires=({package!r},)"}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (NO_CODE, "ModuleNotFoundError: No module named 'nowhere'"),
        (NO_CODE | LEARNED, "ModuleNotFoundError: No module named 'nowhere'"),
        (requires("nowhere-at-all"), "PluginError: 'odd' .*pip install nowhere-at-all"),
    ],
)
def test_a_method_without_its_code_or_package_does_not_stop_the_others(
    clip_folder, tmp_path, changes, reason
):
    use_changed_plugin(tmp_path, changes)
    done = measure_scores(run_plan(clip_folder, "odd", "mean"), tmp_path / "r")
    assert done == RunSummary(measured=1, failed=1)
    assert any(re.match(reason, note) for note in reasons(tmp_path / "r"))


def test_a_cell_that_failed_is_tried_again(clip_folder, tmp_path):
    needed, plan = use_method_that_needs_a_file(tmp_path), run_plan(clip_folder, "odd")
    needed.unlink()
    for _ in range(2):
        assert measure_scores(plan, tmp_path / "r") == RunSummary(failed=1)
    needed.touch()
    assert measure_scores(plan, tmp_path / "r") == RunSummary(measured=1)
    assert len(table.cells(tmp_path / "r")) == 1


def test_a_full_disk_ends_the_run_and_leaves_what_is_measured(tmp_path, monkeypatch):
    clips, read = [write_noise(tmp_path / name) for name in "abc"], CellLoader.clip

    def read_until_full(loader, cell, *arguments):
        if cell.header.name != "a":
            raise WriteError("no space left")
        return read(loader, cell, *arguments)

    monkeypatch.setattr(CellLoader, "clip", read_until_full)
    with pytest.raises(WriteError, match="no space left"):
        measure_scores(RunPlan(("mean",), tuple(map(StoredSource, clips)), (1.0,)), tmp_path / "r")
    assert [cell.key.clip for cell in table.cells(tmp_path / "r")] == ["a"]


def test_two_clips_of_one_name_are_refused(tmp_path):
    folders = [write_noise(tmp_path / place / "same") for place in ("a", "b")]
    twins = RunPlan(("mean",), tuple(map(StoredSource, folders)), (1.0,))
    with pytest.raises(CellsError, match="2 of the clips are called 'same'"):
        measure(twins, tmp_path / "r")


@pytest.mark.parametrize(
    ("adaptive", "cap", "spp", "needed"),
    [
        (True, None, 0.5, 8),
        (True, 5, 0.5, 5),
        (True, 9, 0.5, 8),
        (False, None, 0.5, 1),
        (False, None, 3.2, 4),
        (False, 3, 3.2, 3),
        (False, None, 0.0, 1),
    ],
)
def test_only_samples_that_can_be_drawn_are_read(adaptive, cap, spp, needed):
    traits = replace(registry.get_variant("mean").traits, adaptive=adaptive, max_samples=cap)
    assert max_samples_needed(traits, spp, 8) == needed


def test_other_weights_have_rows_of_their_own_and_unlearned_methods_none(clip_folder, tmp_path):
    shipped = Path(registry.module_file("methods.ours:FAMILY")).parent / "cards" / "A2.safetensors"
    own = shutil.copy(shipped, tmp_path / "my own.safetensors")
    options = [{}, {"weights": "random"}, {"weights": str(own)}]
    for each in [*options, {"weights": "random", "weights_label": "seed0"}]:
        plan = run_plan(clip_folder, "ours/A2", "mean", limit_frames=1, **each)
        assert measure_scores(plan, tmp_path / "r").replaced == 0
    methods = {f"ours/A2{label}" for label in ("", "@random", "@my-own", "@seed0")}
    assert set(table.read(tmp_path / "r")["method"]) == {*methods, "mean"}


def test_an_older_cell_that_a_kill_left_is_removed_by_the_next_run(clip_folder, tmp_path):
    plan = run_plan(clip_folder)
    measure_scores(plan, tmp_path / "r")
    (cell,) = table.cells(tmp_path / "r")
    rows = [table.Row(**row) for row in table.read(tmp_path / "r").to_dict("records")]
    table.write_cell(tmp_path / "r", replace(cell, content_hash="0123456789abcdef"), rows)
    assert measure_scores(plan, tmp_path / "r") == RunSummary(cached=1)
    assert table.cells(tmp_path / "r") == {cell}


@pytest.mark.parametrize("name", ["half", "crossval-3"])
def test_weights_never_have_a_reserved_label(clip_folder, tmp_path, name):
    plan = run_plan(clip_folder, "ours/A2", weights=f"runs/{name}.safetensors")
    assert row_name(plan, "ours/A2") == f"ours/A2@weights-{name}"


@pytest.mark.parametrize("side", [9, 11])
def test_a_clip_too_small_for_one_metric_has_scores_of_the_others(tmp_path, side):
    measure_scores(run_plan(write_noise(tmp_path / "small", h=side, w=24)), tmp_path / "r")
    rows = table.read(tmp_path / "r")
    ms_ssim = rows[rows["metric"].str.startswith("ms_ssim")]
    assert ms_ssim["value"].notna().all() == (side == 11)
    assert ms_ssim["note"].str.contains("below 11 pixels").all() == (side == 9)
    assert rows[rows["metric"] == "psnr"]["value"].notna().all()


def test_first_frames_never_replace_a_whole_clip(clip_folder, tmp_path):
    measure_scores(run_plan(clip_folder, limit_frames=1), tmp_path / "r")
    plan = run_plan(clip_folder)
    assert measure_scores(plan, tmp_path / "r").replaced == 1  # replacing first frames is intended
    before = _files(tmp_path / "r")
    with pytest.raises(CellsError, match=r"mean on noise at 1 spp.*whole clip.*--limit-frames"):
        measure_scores(replace(plan, limit_frames=2), tmp_path / "r")
    assert _files(tmp_path / "r") == before


@pytest.mark.parametrize(("name", "trained"), [("generated-001", True), ("generated-x", False)])
def test_a_score_on_a_training_clip_has_a_note_that_it_is_no_test(tmp_path, name, trained):
    plan = run_plan(write_noise(tmp_path / name), "oidn/tuned", "mean", limit_frames=1)
    measure_scores(plan, tmp_path / "r")
    rows = table.read(tmp_path / "r")
    remark = "no test: its weights were trained on generated-001"
    learned = rows[(rows["metric"] == "psnr") & (rows["method"] == "oidn/tuned")]
    assert set(learned["note"]) == ({remark} if trained else {""})
    assert remark not in set(rows[rows["method"] == "mean"]["note"])


def test_the_rows_of_a_plan_are_those_of_its_cells_alone(clip_folder, tmp_path):
    measure_scores(run_plan(clip_folder, "mean", "eaw", spp=(1.0, 2.0)), tmp_path / "r")
    plan = run_plan(clip_folder, "eaw", spp=(2.0,))
    rows = read_cells(plan, tmp_path / "r")
    assert set(zip(rows["method"], rows["target_spp"], strict=True)) == {("eaw", 2.0)}
    assert list(rows.columns) == list(table.COLUMNS)
    assert (rows["metric"] == "psnr").sum() == 3  # one a frame


def test_rows_of_methods_with_a_memory_have_the_drift_of_their_frames(tmp_path):
    folder = write_noise(tmp_path / "noise", frames=5)
    measure_scores(run_plan(folder, "mean", "svgf"), tmp_path / "r")
    rows = table.read(tmp_path / "r")
    found = rows[rows["metric"] == "drift"]
    assert found[["method", "frame", "unit"]].values.tolist() == [["svgf", -1, "dB"]]
    psnr = rows[(rows["metric"] == "psnr") & (rows["method"] == "svgf")].set_index("frame")["value"]
    assert found["value"].item() == pytest.approx(psnr[4] - psnr[0])
