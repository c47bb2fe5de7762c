"""What all reports promise: files as named, one section or figure a device, helpful refusals."""

from __future__ import annotations

import importlib
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from rlbench.benchmark.results import (
    COUNT_PREFIX,
    NOISE_CEILING,
    MissingRowsError,
    TableError,
    to_dataframe,
)
from tests.reports.conftest import renamed, rows
from tests.reports.formula_results import doubt

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
REPORTS = PROJECT["entry-points"]["rlbench.reports"]
PAGE, FIGURE = ("md", "csv", "tex"), ("png", "pdf", "svg")  # suffixes
FILES = {name: [f"{name}.{suffix}" for suffix in PAGE] for name in REPORTS} | {
    name: [f"{name}.{suffix}" for suffix in (*FIGURE, "csv")]
    for name in ("pareto", "winners", "frame-time")
}
FILES["recovery"] = [f"recovery.{suffix}" for suffix in (*PAGE, *FIGURE)]
FILES["paper-pareto"] = [f"paper-{axis}.{s}" for axis in ("spp", "time") for s in FIGURE]
FILES["paper-pareto"] += ["paper-pareto.csv"]
PLAIN = ("summary", "clips", "last-frames")  # which any scores satisfy


def writer(name):
    module, _, function = REPORTS[name].partition(":")
    return getattr(importlib.import_module(module), function)


@pytest.fixture(scope="module")
def everything():
    """Rows that every report has something to say about, at 1 and 4 spp."""
    some = [r for r in rows(("mean", "ntas", "ours")) if r.target_spp in (1, 4)]
    ours = [r for r in some if r.method == "ours"]
    table = some + renamed(ours, ours="ours/latent") + renamed(ours, ours="ours/by-rule")
    psnr = [r for r in table if r.metric == "psnr"]
    for seed in range(2):
        label = f"ours@seed{seed}"
        table += [
            replace(r, method=label, weights_hash=label, value=r.value + seed, seed=s)
            for r in psnr
            if r.method == "ours"
            for s in range(2)
        ]
    for row in psnr:
        table += [
            replace(row, metric="psnr_debiased", value=row.value + 0.1),
            replace(row, metric=NOISE_CEILING, value=60.0),
        ]
        if row.frame == 0:
            table += [replace(row, metric="event_cut", value=1.0, unit="", direction="")]
            counts = {f"{COUNT_PREFIX}{n}": share for n, share in enumerate((30.0, 40.0, 30.0))}
            counts |= {"effort_noise": 0.5, "effort_error": 0.1, "at_cap": 2.0}
            table += [
                replace(row, frame=-1 if COUNT_PREFIX in m else 0, metric=m, value=v, unit="")
                for m, v in counts.items()
            ]
    return to_dataframe([replace(r, preset="real", size="64x64") for r in table])


@pytest.mark.parametrize("name", REPORTS)
def test_a_report_writes_the_files_that_it_names_with_a_section_or_figures_of_each_device(
    name, everything, tmp_path
):
    # one scene is enough for the other device
    is_other = (everything["scene"] == "hall") & (everything["metric"] != "sample_ms")
    device = everything["device"].mask(is_other, "H100")
    split = everything.assign(device=device.mask(everything["metric"] == "sample_ms", ""))
    if name == "variance":  # one scene has none
        with pytest.raises(MissingRowsError):
            writer(name)(everything[everything["scene"] == "city"], tmp_path)
        split = pd.concat([everything, everything.assign(device="H100")])
    files = writer(name)(split, tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(files)
    names = [re.sub("-(h100|nvidia-rtx-2080-ti)[.]", ".", file.name) for file in files]
    is_page = files[0].suffix == ".md"
    assert sorted(names) == sorted(
        file for file in FILES[name] for _ in range(1 if is_page and file.endswith(PAGE) else 2)
    )
    for file in files:
        assert file.stat().st_size > 100
        if file.suffix == ".csv":
            assert len(pd.read_csv(file))
        if file.suffix == ".md":
            page = file.read_text()
            assert {"## NVIDIA RTX 2080 Ti", "## H100"} <= set(page.splitlines())
            assert page.count("### ") > 0
            assert "Runs: r1" in page
        if file.suffix == ".tex":
            assert r"\toprule" in file.read_text()


@pytest.mark.parametrize("name", REPORTS)
def test_an_empty_table_is_refused(name, everything, tmp_path):
    with pytest.raises(TableError):
        writer(name)(everything.iloc[:0], tmp_path)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", REPORTS)
def test_results_without_the_rows_of_a_report_say_what_to_run(name, tmp_path):
    """Scores of one unknown method on one clip, without times."""
    table = [r for r in renamed(rows(["ntas"]), ntas="mine") if r.metric == "psnr"]
    few = to_dataframe([replace(r, preset="mini") for r in table if r.clip == "city-0"])
    if name in PLAIN:
        assert writer(name)(few, tmp_path)
        return
    with pytest.raises(TableError, match="rlbench run") as error:
        writer(name)(few, tmp_path)
    assert isinstance(error.value, MissingRowsError) or name == "pareto"


@pytest.mark.parametrize("name", ["summary", "pareto"])
def test_equal_results_give_equal_files(name, results, tmp_path):
    some = results[results["target_spp"].isin([1, 4]) & results["scene"].isin(["city", "hall"])]
    first, second = (writer(name)(some, tmp_path / folder) for folder in "ab")
    assert [file.read_bytes() for file in first] == [file.read_bytes() for file in second]


@pytest.mark.parametrize("name", ["summary", "table1", "ablation"])
def test_pages_mark_uncertain_times_and_give_the_reason(name, everything, tmp_path):
    page = writer(name)(doubt(everything, "ours", scene="hall", high=40), tmp_path)[0].read_text()
    assert "- inference_ms of ours on hall at 1, 4 spp: the machine was busy" in page
    assert re.search(r"\d ±[\d.]+( %)? \|", page)


def test_rows_that_cannot_share_a_mean_are_refused(results, tmp_path):
    mixed = results.assign(code_hash=["a", "b"] * (len(results) // 2))
    for name in ("summary", "pareto", "clips", "equal_time"):
        with pytest.raises(TableError, match="code_hash"):
            writer(name)(mixed, tmp_path)
