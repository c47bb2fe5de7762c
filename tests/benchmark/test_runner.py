"""Measuring: cells, resuming, and reasons."""

from __future__ import annotations

import importlib.metadata
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from reports.analysis.aggregate import points
from rlbench import registry
from rlbench.benchmark import results as table
from rlbench.benchmark.cell_ids import CellIds
from rlbench.benchmark.clip_sources import StoredSource, max_samples_needed
from rlbench.benchmark.run_plan import CellsError, RunPlan, cells
from rlbench.benchmark.runner import RunSummary, measure
from rlbench.clips.stored import open_clip
from rlbench.system import code_hash, provenance
from tests.conftest import write_noise, write_plugin

MS = "_ms"  # end of the names of times, which no two runs share


def request(folder: Path, *methods: str, **asked: object) -> RunPlan:
    return RunPlan(
        methods or ("mean",), (StoredSource(folder),), **{"spp": (1.0,), "repeats": 2, **asked}
    )


def scores(results: Path) -> list[tuple]:
    """All rows but times, without the run's own name."""
    rows = table.read(results)
    kept = rows[~rows["metric"].str.endswith(MS)].drop(columns="run")
    return sorted(kept.itertuples(index=False, name=None), key=repr)


def reasons(results: Path) -> list[str]:
    return sorted(set(table.read(results)["note"]) - {""})


def test_every_frame_has_a_row_of_every_metric(tmp_path):
    folder = write_noise(tmp_path / "large", h=176, w=176, frames=2)  # MS-SSIM needs 161
    assert measure(request(folder), tmp_path / "r") == RunSummary(measured=1)
    rows = table.read(tmp_path / "r")
    found = set(zip(rows["frame"], rows["metric"], strict=True))
    assert {(f, m) for f, m in found if f >= 0} == {
        (frame, metric) for frame in (0, 1) for metric in registry.names("metrics")
    } - {(0, "tpsnr")}  # which needs the frame before


def test_psnr_of_the_mean_is_that_of_numpy(clip_folder, tmp_path):
    measure(request(clip_folder, spp=(8.0,)), tmp_path / "r")
    rows = table.read(tmp_path / "r")
    found = rows[(rows["metric"] == "psnr") & (rows["frame"] == 1)]["value"].item()

    frame = list(open_clip(clip_folder))[1]
    shown, truth = (
        _srgb(image[0].numpy().astype(np.float64))
        for image in (frame.pool.radiance.mean(1), frame.reference.mean)
    )
    # float32 sums of eight samples
    assert found == pytest.approx(-10 * math.log10(((shown - truth) ** 2).mean()), abs=1e-3)


def test_total_time_is_plan_denoise_and_samples(clip_folder, tmp_path):
    measure(request(clip_folder, spp=(2.0,), cost="paper-2080ti"), tmp_path / "r")
    times = table.read(tmp_path / "r").set_index("metric")["value"]
    published = 26.3 * (20 * 24) / (720 * 720)
    assert times["sample_ms"] == pytest.approx(published)
    inference = times["plan_ms"] + times["denoise_ms"]
    assert times["total_ms"] == pytest.approx(inference + 2 * published)


def test_the_report_has_the_total_of_the_table(clip_folder, tmp_path):
    measure(request(clip_folder, spp=(2.0,), cost="paper-2080ti"), tmp_path / "r")
    rows = table.read(tmp_path / "r")
    (total,) = rows[rows["metric"] == "total_ms"]["value"]
    assert points(rows)["total_ms"].item() == pytest.approx(total)


def test_a_second_run_measures_nothing(clip_folder, tmp_path):
    measure(request(clip_folder), tmp_path / "r")
    before = _files(tmp_path / "r")
    assert measure(request(clip_folder), tmp_path / "r") == RunSummary(cached=1)
    assert _files(tmp_path / "r") == before


def test_scores_of_two_runs_are_equal_bit_for_bit(clip_folder, tmp_path):
    for place in ("a", "b"):
        measure(request(clip_folder, spp=(0.5, 3.0), seeds=(0, 1)), tmp_path / place)
    assert scores(tmp_path / "a") == scores(tmp_path / "b")


def test_a_run_that_was_cut_short_ends_as_an_undisturbed_one(clip_folder, tmp_path):
    asked = request(clip_folder, spp=(0.5, 1.0, 2.0))

    class CutError(Exception):
        pass

    def cut(cell):
        if cell.spp == 1.0:
            raise CutError

    with pytest.raises(CutError):
        measure(asked, tmp_path / "r", cut)
    assert measure(asked, tmp_path / "r") == RunSummary(measured=1, cached=2)
    measure(asked, tmp_path / "undisturbed")
    assert scores(tmp_path / "r") == scores(tmp_path / "undisturbed")


def test_what_else_is_measured_does_not_change_a_cell(clip_folder, tmp_path):
    measure(request(clip_folder, spp=(1.0,)), tmp_path / "alone")
    measure(request(clip_folder, spp=(8.0, 1.0)), tmp_path / "both")
    assert set(scores(tmp_path / "alone")) <= set(scores(tmp_path / "both"))


@pytest.mark.parametrize(
    "asked", [{"seeds": (1,)}, {"spp": (2.0,)}, {"cost": "paper-2080ti"}, {"repeats": 3}]
)
def test_another_request_is_another_cell(clip_folder, tmp_path, asked):
    measure(request(clip_folder), tmp_path / "r")
    assert measure(request(clip_folder, **asked), tmp_path / "r") == RunSummary(measured=1)


def test_changed_code_replaces_the_older_rows(clip_folder, tmp_path):
    plugin = write_plugin(tmp_path / "grey.py", "grey", gain=1.0)
    registry.use_plugin(plugin)
    measure(request(clip_folder, "grey"), tmp_path / "r")
    write_plugin(plugin, "grey", gain=0.5)
    assert measure(request(clip_folder, "grey"), tmp_path / "r") == RunSummary(measured=1)
    assert len(table.cells(tmp_path / "r")) == 1


def test_changed_code_beside_that_of_a_method_counts(clip_folder, tmp_path, monkeypatch):
    package = tmp_path / "faraway"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "net.py").write_text("WIDTH = 8\n")
    method = write_plugin(package / "method.py", "far", build="return Scaled()")
    text = method.read_text().replace('"method:build"', '"faraway.method:build"')
    method.write_text(f"from faraway.net import WIDTH\n{text}")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv(registry.VARIABLE, "far=faraway.method:FAMILY")

    assert measure(request(clip_folder, "far"), tmp_path / "r") == RunSummary(measured=1)
    assert measure(request(clip_folder, "far"), tmp_path / "r") == RunSummary(cached=1)
    (package / "net.py").write_text("WIDTH = 9\n")
    assert measure(request(clip_folder, "far"), tmp_path / "r") == RunSummary(measured=1)


@pytest.mark.parametrize(
    ("plugin", "header", "spp", "reason"),
    [
        ({"traits": "spp=(1.0, 4.0)"}, {}, 8.0, "supports 1 to 4 spp, requested 8"),
        ({"traits": "pool='odd'"}, {}, 1.0, "buys from a 'odd' pool, the clip has: path"),
        (
            {"traits": "needs=frozenset({'depth'})"},
            {"buffers": ("albedo",)},
            1.0,
            "reads depth, the clip has: albedo",
        ),
        ({}, {"pool_spp": 4}, 8.0, "8 spp asked for, the clip holds 4 samples of each pixel"),
        ({"body": "raise RuntimeError('no luck')"}, {}, 1.0, "RuntimeError: no luck"),
        (
            {"body": "return samples.mean[:, :1], None"},
            {},
            1.0,
            "PluginError: 'odd' returned an image of torch.float32 [1, 1, 20, 24], "
            "wanted torch.float32 [1, 3, 20, 24]",
        ),
        (
            {"body": "return samples.mean.half(), None"},
            {},
            1.0,
            "PluginError: 'odd' returned an image of torch.float16 [1, 3, 20, 24], "
            "wanted torch.float32 [1, 3, 20, 24]",
        ),
        ({"build": "raise OSError('no weights')"}, {}, 1.0, "OSError: no weights"),
        (
            {"body": "return samples.mean * float('nan'), None"},
            {},
            1.0,
            None,  # scored as errors, not refused
        ),
    ],
)
def test_a_cell_that_cannot_run_is_one_row_that_says_why(tmp_path, plugin, header, spp, reason):
    registry.use_plugin(write_plugin(tmp_path / "odd.py", "odd", **plugin))
    folder = write_noise(tmp_path / "clip", **header)
    done = measure(request(folder, "odd", spp=(spp,), cost="paper-2080ti"), tmp_path / "r")
    assert done == (RunSummary(skipped=1) if reason else RunSummary(measured=1))
    default = "the profile's default, as it has no 'noise'"
    assert reasons(tmp_path / "r") == [reason or default]
    if reason:
        (row,) = table.read(tmp_path / "r").itertuples()
        assert (row.frame, row.metric, math.isnan(row.value)) == (-1, "psnr", True)


def test_a_clip_in_which_nothing_is_moved_is_timed_by_itself(tmp_path):
    seen = tmp_path / "seen"
    body = f"print(1, file=open({str(seen)!r}, 'a')); return samples.mean, None"
    registry.use_plugin(write_plugin(tmp_path / "odd.py", "odd", body=body))
    frames = []
    for name, second in (("one", {}), ("two", {"static": True}), ("short", {"frames": 1})):
        seen.unlink(missing_ok=True)
        clips = [write_noise(tmp_path / name / "a"), write_noise(tmp_path / name / "b", **second)]
        measure(
            RunPlan(("odd",), tuple(map(StoredSource, clips)), (1.0,), repeats=5), tmp_path / name
        )
        frames.append(len(seen.read_text().splitlines()))
    # scored, and timed after 2 frames of warm-up
    assert frames == [2 * 3 + 7, 2 * (3 + 7), 3 + 7 + 1 + 7]


@pytest.mark.parametrize("learned", [False, True])
def test_a_method_whose_code_is_not_there_does_not_stop_the_others(clip_folder, tmp_path, learned):
    plugin = write_plugin(tmp_path / "odd.py", "odd")
    text = plugin.read_text().replace('"odd:build"', '"nowhere.at.all:build"')
    plugin.write_text(text.replace("learned=False", f"learned={learned}"))
    registry.use_plugin(plugin)
    done = measure(request(clip_folder, "odd", "mean"), tmp_path / "r")
    assert done == RunSummary(measured=1, skipped=1)
    assert "ModuleNotFoundError: No module named 'nowhere'" in reasons(tmp_path / "r")


def packaged(path: Path, package: str) -> Path:
    """A plugin whose images are made by another package."""
    plugin = write_plugin(path, "odd")
    told = f"learned=False, packages=({package!r},)"
    plugin.write_text(plugin.read_text().replace("learned=False", told))
    return plugin


def test_a_package_that_is_not_installed_is_a_reason_with_what_to_do(clip_folder, tmp_path):
    registry.use_plugin(packaged(tmp_path / "odd.py", "nowhere-at-all"))
    done = measure(request(clip_folder, "odd", "mean"), tmp_path / "r")
    assert done == RunSummary(measured=1, skipped=1)
    reason = (
        "PluginError: 'odd' needs nowhere-at-all, which is not here: pip install nowhere-at-all"
    )
    assert reason in reasons(tmp_path / "r")


def test_another_version_of_a_package_that_makes_the_images_is_measured_anew(
    clip_folder, tmp_path, monkeypatch
):
    registry.use_plugin(packaged(tmp_path / "odd.py", "numpy"))
    assert measure(request(clip_folder, "odd"), tmp_path / "r") == RunSummary(measured=1)
    assert measure(request(clip_folder, "odd"), tmp_path / "r") == RunSummary(cached=1)
    monkeypatch.setattr(importlib.metadata, "version", lambda name: f"99.{len(name)}")
    assert measure(request(clip_folder, "odd"), tmp_path / "r") == RunSummary(
        measured=1, replaced=1
    )
    assert set(table.read(tmp_path / "r").weights) == {"numpy 99.5"}


def test_one_failing_method_does_not_stop_the_others(clip_folder, tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "odd.py", "odd", body="raise RuntimeError('no')"))
    done = measure(request(clip_folder, "odd", "mean"), tmp_path / "r")
    assert done == RunSummary(measured=1, skipped=1)


def test_a_cell_that_failed_is_tried_again(clip_folder, tmp_path):
    body = f"open({str(tmp_path / 'there')!r}); return samples.mean, None"
    registry.use_plugin(write_plugin(tmp_path / "odd.py", "odd", body=body))
    for _ in range(2):
        assert measure(request(clip_folder, "odd"), tmp_path / "r") == RunSummary(skipped=1)
    (tmp_path / "there").touch()
    assert measure(request(clip_folder, "odd"), tmp_path / "r") == RunSummary(measured=1)
    assert len(table.cells(tmp_path / "r")) == 1


def test_a_budget_that_a_method_does_not_support_is_not_tried_again(clip_folder, tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "odd.py", "odd", traits="spp=(2.0, 4.0)"))
    measure(request(clip_folder, "odd"), tmp_path / "r")
    assert measure(request(clip_folder, "odd"), tmp_path / "r") == RunSummary(cached=1)


def test_two_clips_of_one_name_are_refused(tmp_path):
    folders = [write_noise(tmp_path / place / "same") for place in ("a", "b")]
    twins = RunPlan(("mean",), tuple(map(StoredSource, folders)), spp=(1.0,))
    with pytest.raises(CellsError, match="2 of the clips given are called 'same'"):
        measure(twins, tmp_path / "r")


def test_an_unknown_method_stops_the_run_before_it_begins(clip_folder, tmp_path):
    there = ", ".join(registry.names("methods"))
    told = re.escape(f"'foo' is not a method; there are: {there}")
    with pytest.raises(registry.PluginError, match=told):
        measure(request(clip_folder, "mean", "foo"), tmp_path / "r")
    assert not (tmp_path / "r").exists()


def test_cells_are_the_whole_grid(clip_folder):
    asked = request(clip_folder, "mean", "ours", spp=(1.0, 2.0), seeds=(0, 1, 2))
    assert len(cells(asked)) == 2 * 2 * 3


@pytest.mark.parametrize(
    ("adapts", "cap", "spp", "slots"),
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
def test_only_samples_that_can_be_bought_are_read(adapts, cap, spp, slots):
    traits = replace(registry.variant("mean").traits, adaptive=adapts, max_samples=cap)
    assert max_samples_needed(traits, spp, 8) == slots


def test_fewer_samples_read_are_the_same_samples(clip_folder):
    few, all_ = (next(iter(open_clip(clip_folder, max_samples=n))).pool.radiance for n in (3, 8))
    assert torch.equal(few, all_[:, :3])


def test_named_weights_are_a_row_of_their_own_and_leave_unlearned_methods_alone(
    clip_folder, tmp_path
):
    asked = request(clip_folder, "ours/A2", "mean", weights="random", called="seed0", frames=1)
    measure(asked, tmp_path / "r")
    assert set(table.read(tmp_path / "r")["method"]) == {"ours/A2@seed0", "mean"}


def test_weights_without_a_name_never_replace_scores_of_those_that_ship(clip_folder, tmp_path):
    shipped = Path(registry.module_file("methods.ours:FAMILY")).parent / "cards" / "A2.safetensors"
    shutil.copy(shipped, tmp_path / "my own.safetensors")
    for weights in (None, "random", str(tmp_path / "my own.safetensors")):
        asked = request(clip_folder, "ours/A2", "mean", weights=weights, frames=1)
        assert measure(asked, tmp_path / "r").replaced == 0
    rows = table.read(tmp_path / "r")
    assert set(rows["method"]) == {"ours/A2", "ours/A2@random", "ours/A2@my-own", "mean"}
    assert CellIds(replace(asked, methods=("ours/ppo",))).method("ours/ppo") == "ours/ppo"


def test_an_older_copy_that_a_kill_has_left_is_removed_by_the_next_run(clip_folder, tmp_path):
    asked = request(clip_folder)
    measure(asked, tmp_path / "r")
    (name,) = table.cells(tmp_path / "r")
    rows = [table.Row(**row) for row in table.read(tmp_path / "r").to_dict("records")]
    table.write_cell(tmp_path / "r", name.rpartition(" ")[0] + " 0123456789abcdef", rows)
    assert measure(asked, tmp_path / "r") == RunSummary(cached=1)
    assert table.cells(tmp_path / "r") == {name}


def test_another_price_of_a_pool_is_another_cell(tmp_path):
    """A profile knows path samples; of another pool they cost as many as was measured."""
    found = set()
    for price in (4.0, 8.0):
        pools = {"pools": ("path", "restir"), "pools_ms": (2.0, price)}
        folder = write_noise(tmp_path / "noise", **pools)
        for file in folder.glob("pool.path.*"):
            shutil.copy(file, folder / file.name.replace("path", "restir"))
        asked = request(folder, "restir", "mean", cost="paper-2080ti")
        found |= {CellIds(asked).cell_id(cell) for cell in cells(asked)}
    assert sorted(name.partition(" ")[0] for name in found) == ["mean", "restir", "restir"]


def test_what_a_loose_file_imports_decides_its_name(clip_folder, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    plugin = write_plugin(tmp_path / "odd.py", "odd")
    plugin.write_text("import beside_it\n" + plugin.read_text())
    registry.use_plugin(plugin)
    asked, names = request(clip_folder, "odd", "mean"), []
    for width in (4, 8):
        (tmp_path / "beside_it.py").write_text(f"WIDTH = {width}\n")
        names.append([CellIds(asked).cell_id(cell) for cell in cells(asked)])
    (odd, mean), (changed, same) = names
    assert odd != changed
    assert mean == same


@pytest.mark.parametrize(
    "line",
    [
        "from helpers import net",
        "try:\n    from .net import WIDTH\nexcept ImportError:\n    pass",
        "try:\n    from torn import WIDTH\nexcept ZeroDivisionError:\n    pass",
    ],
)
def test_whatever_a_loose_file_imports_it_has_a_hash(clip_folder, tmp_path, monkeypatch, line):
    monkeypatch.syspath_prepend(tmp_path)
    for folder, text in (("helpers", "net"), ("torn", "__init__")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / f"{text}.py").write_text("1 / 0" if folder == "torn" else "WIDTH = 4")
    plugin = write_plugin(tmp_path / "odd.py", "odd")
    plugin.write_text(f"{line}\n{plugin.read_text()}")
    registry.use_plugin(plugin)
    first = CellIds(request(clip_folder, "odd")).code["odd"]
    (tmp_path / "helpers" / "net.py").write_text("WIDTH = 8")
    changed = CellIds(request(clip_folder, "odd")).code["odd"]
    assert len(first) == len(changed) == 16
    assert (first != changed) == ("helpers" in line)


@pytest.mark.parametrize("name", ["half", "crossval-3"])
def test_weights_are_never_called_as_rows_of_another_kind(clip_folder, tmp_path, name):
    told = CellIds(request(clip_folder, "ours/A2", weights=f"runs/{name}.safetensors"))
    assert told.method("ours/A2") == f"ours/A2@weights-{name}"


def test_samples_that_another_machine_is_charged_for_are_measured_anew(clip_folder, monkeypatch):
    asked, found = request(clip_folder), set()
    for cores in (2, 16):
        here = provenance.Machine("cpu", cores, "gpu", "os")
        monkeypatch.setattr(provenance, "machine", lambda here=here: here)
        names = CellIds(asked)
        monkeypatch.setitem(names.__dict__, "device", "gpu")
        found |= {names.cell_id(cell) for cell in cells(asked)}
    assert len(found) == 2


@pytest.mark.parametrize("side", [9, 11])
def test_a_clip_too_small_for_one_metric_has_scores_of_the_others(tmp_path, side):
    measure(request(write_noise(tmp_path / "small", h=side, w=24)), tmp_path / "r")
    rows = table.read(tmp_path / "r")
    found = rows[rows["metric"].str.startswith("ms_ssim")]
    assert found["value"].notna().all() == (side == 11)
    assert found["note"].str.contains("below 11 pixels").all() == (side == 9)
    assert rows[rows["metric"] == "psnr"]["value"].notna().all()


def test_first_frames_never_replace_a_whole_clip(clip_folder, tmp_path):
    measure(request(clip_folder, frames=1), tmp_path / "r")
    whole = request(clip_folder)
    assert measure(whole, tmp_path / "r").replaced == 1  # the other way round is meant
    before = _files(tmp_path / "r")
    with pytest.raises(CellsError, match=r"mean noise 1spp.*whole clip.*--limit-frames.*--out"):
        measure(replace(whole, frames=2), tmp_path / "r")
    assert _files(tmp_path / "r") == before


def test_a_clip_of_another_preset_never_replaces_one_of_its_name(tmp_path):
    mini, standard, own = (
        write_noise(tmp_path / preset / "noise", preset=preset) for preset in ("mini", "big", "")
    )
    measure(request(mini), tmp_path / "r")
    assert set(table.read(tmp_path / "r")["preset"]) == {"mini"}
    before = _files(tmp_path / "r")
    for other, named in ((standard, "preset big"), (own, "no preset")):
        with pytest.raises(CellsError, match=f"mean noise 1spp.*preset mini.*{named}.*--out"):
            measure(request(other), tmp_path / "r")
    assert _files(tmp_path / "r") == before


def test_a_sample_that_was_timed_anew_is_charged_anew(tmp_path):
    here = provenance.machine().name
    for price in (2.0, 99.0):
        folder = write_noise(tmp_path / "noise", sample_ms=price, device=here)
        assert measure(request(folder), tmp_path / "r").measured == 1
    rows = table.read(tmp_path / "r")
    assert set(rows[rows["metric"] == "sample_ms"]["value"]) == {99.0}


@pytest.mark.parametrize(("name", "told"), [("generated-001", True), ("generated-x", False)])
def test_a_score_on_a_clip_that_was_trained_on_says_that_it_is_no_test(tmp_path, name, told):
    asked = request(write_noise(tmp_path / name), "oidn/small", "mean", frames=1)
    measure(asked, tmp_path / "r")
    rows = table.read(tmp_path / "r")
    remark = "no test: its weights were trained on generated-001"
    learned = rows[(rows["metric"] == "psnr") & (rows["method"] == "oidn/small")]
    assert set(learned["note"]) == ({remark} if told else {""})
    assert remark not in set(rows[rows["method"] == "mean"]["note"])


@pytest.mark.parametrize(
    "part", ["rlbench.ops.dither", "baselines.oidn.method", "methods.ours.accumulation"]
)
def test_what_ours_is_made_of_decides_its_name(clip_folder, monkeypatch, part):
    asked = request(clip_folder, "ours")
    (cell,) = cells(asked)
    before, sources = CellIds(asked).cell_id(cell), code_hash._sources

    def changed(name: str) -> list[tuple[str, Path]]:
        found = sources(name)
        return [(f"{place}, changed", path) for place, path in found] if name == part else found

    monkeypatch.setattr(code_hash, "_sources", changed)
    assert CellIds(asked).cell_id(cell) != before


def _files(folder: Path) -> dict[str, int]:
    return {file.name: file.stat().st_mtime_ns for file in folder.iterdir()}


def _srgb(linear: np.ndarray) -> np.ndarray:
    x = linear.clip(0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
