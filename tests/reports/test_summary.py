"""The summary: numbers that a hand can check, ties called ties, and reasons as a list."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pandas as pd
import pytest
from conftest import METHODS, SAMPLE_MS, SCENES, rows

from reports import summary
from reports.analysis.ranking import ranking
from reports.layout.tables import Bold, Grid, latex, markdown
from rlbench.benchmark.results import to_dataframe

OFFSET = sum(SCENES.values()) / 4


def written(table, folder):
    return [file.read_text() for file in summary.write(table, folder, draws=500)]


@pytest.fixture(scope="module")
def folder(results, tmp_path_factory):
    made = tmp_path_factory.mktemp("summary")
    summary.write(results, made, draws=500)
    return made


@pytest.fixture(scope="module")
def page(folder):
    return (folder / "summary.md").read_text()


def line(text, title, start):
    """The first line below a heading that starts with these words."""
    return next(x for x in text[text.index(f"### {title}") :].splitlines() if x.startswith(start))


def tied(gap):
    """Two methods whose scenes, of two clips, differ by +1 and -1 dB in turn, plus `gap`."""
    ours = [r for r in rows(["ours"]) if r.metric == "psnr"]
    swing = {clip: 1 - 2 * (i // 2 % 2) for i, clip in enumerate(sorted({r.clip for r in ours}))}
    theirs = [replace(r, method="theirs", value=r.value + gap + swing[r.clip]) for r in ours]
    return to_dataframe(ours + theirs)


def test_three_files_are_written(tmp_path):
    files = summary.write(tied(0.0), tmp_path, draws=100)
    assert [file.name for file in files] == ["summary.md", "summary.csv", "summary.tex"]
    assert sorted(tmp_path.iterdir()) == sorted(files)


@pytest.mark.parametrize("method", ["ntas", "oidn", "mean"])
def test_the_table_has_the_mean_over_scenes(page, method):
    found = line(page, "psnr [dB], mean over scenes", f"| {method} ").split("|")[3]
    assert found.split()[0] == f"{METHODS[method][0] + OFFSET:.2f}"


def test_the_best_is_bold_and_alone(page):
    section = page[page.index("### psnr [dB], mean over") : page.index("### relmse")]
    assert section.count("**") == 2 * 5
    assert line(page, "psnr [dB], mean over", "| ours ").count("**") == 2 * 5


def test_times_are_their_sum(page):
    found = line(page, "time of a frame", "| ours | 2 ").split("|")[2:-1]
    sampling = 1.98 * sum(SAMPLE_MS.values()) / 4
    expected = [2, 1.98, 5.5, 6.05, 11, 13.2, sampling, 16.5 + sampling]
    assert [float(cell) for cell in found] == pytest.approx(expected, abs=0.005)


def test_there_is_a_table_for_each_scene(page):
    titles = re.findall(r"### psnr \[dB\], (.*)", page)
    assert titles == ["mean over scenes", *sorted(SCENES)]


def test_the_csv_has_the_paired_difference(folder):
    found = pd.read_csv(folder / "summary.csv").set_index(
        ["metric", "scene", "target_spp", "method"]
    )
    row = found.loc[("psnr", "all", 1.0, "oidn")]
    assert row["difference"] == pytest.approx(27.5 - 29.9)
    assert (row["clips"], row["frames"], row["best"], row["tie"]) == (8, 32, False, False)


def test_the_interval_of_one_scene_is_that_of_its_clips(results):
    found = ranking(results, "psnr", draws=2000).set_index(["scene", "target_spp", "method"])
    row = found.loc[("city", 1.0, "ntas")]  # its two clips differ from ours by -1.36 and -1.24
    half = 12.7062 * 0.06  # Student's t of two
    assert (row["low"], row["high"]) == pytest.approx((-1.3 - half, -1.3 + half), rel=1e-4)


def test_a_tie_is_called_a_tie(tmp_path):
    text = written(tied(-0.01), tmp_path)[0]
    assert line(text, "psnr [dB], mean over", "| theirs ").count("tie") == 5
    assert line(text, "psnr [dB], mean over", "| ours ").count("**") == 10


def test_a_clear_difference_is_no_tie(tmp_path):
    assert "tie |" not in written(tied(-3.0), tmp_path)[0]


def test_one_clip_a_scene_and_one_scene_has_no_interval_and_no_tie():
    one = to_dataframe([r for r in rows(["ours", "ntas"]) if r.clip == "city-0"])
    found = ranking(one, "psnr")
    assert found["low"].isna().all()
    assert not found["tie"].any()


def test_of_an_error_the_least_is_best(results):
    found = ranking(results, "relmse", draws=100)
    best = found[found["best"] & (found["scene"] == "all")]
    assert best["method"].tolist() == ["ours"] * 5


def test_nothing_is_best_without_a_better_end(results):
    assert not ranking(results.assign(direction=""), "psnr", draws=100)["best"].any()


def test_reasons_are_listed(tmp_path):
    made = rows(["ours"])
    hole = replace(made[0], method="restir", value=math.nan, note="no restir pool")
    text = written(to_dataframe([*made, hole]), tmp_path)[0]
    assert "### Not run\n\n- restir on city at 0.5 spp (psnr): no restir pool" in text


def test_only_reasons_still_make_a_summary(tmp_path):
    hole = replace(rows(["ours"])[0], value=math.nan, note="needs CUDA")
    assert "needs CUDA" in written(to_dataframe([hole]), tmp_path)[0]


def test_each_device_has_a_section(tmp_path):
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], device="H100"))
    text = written(mixed, tmp_path)[0]
    first, second = text.split("## NVIDIA RTX 2080 Ti")
    assert "## H100" in first
    assert ("| ntas" in first, "| ours" in first) == (True, False)
    assert ("| ntas" in second, "| ours" in second) == (False, True)


def test_the_convention_stands_beside_the_score(page):
    assert "peak 1, clipped sRGB. Higher is better." in page


def test_latex_escapes_what_it_must():
    grid = Grid("50 % of a_b", "x & y", ("m", "v"), (("a_b", Bold("1")),))
    text = latex(grid)
    assert r"\caption{50 \% of a\_b. x \& y}" in text
    assert r"a\_b & \textbf{1} \\" in text


def test_markdown_escapes_the_bar_between_columns():
    assert "| a\\|b | **1** |" in markdown(Grid("t", "c", ("m", "v"), (("a|b", Bold("1")),)))
