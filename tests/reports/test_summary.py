"""The summary: numbers checked by hand, verdicts, and lists of what was skipped."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pandas as pd
import pytest

from reports import summary
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import METHODS, SAMPLE_MS, SCENES, rows

OFFSET = sum(SCENES.values()) / 4


def write_and_read(table, folder):
    return [file.read_text() for file in summary.write(table, folder, draws=500)]


@pytest.fixture(scope="module")
def folder(results, tmp_path_factory):
    path = tmp_path_factory.mktemp("summary")
    summary.write(results, path, draws=500)
    return path


@pytest.fixture(scope="module")
def page(folder):
    return (folder / "summary.md").read_text()


def find_line(text, title, start):
    """The first line below the heading `title` that begins with `start`."""
    return next(x for x in text[text.index(f"### {title}") :].splitlines() if x.startswith(start))


def alternating(gap):
    """Two methods that differ by +1 and -1 dB in alternate scenes, plus `gap`."""
    ours = [r for r in rows(["ours"]) if r.metric == "psnr"]
    offsets = {clip: 1 - 2 * (i // 2 % 2) for i, clip in enumerate(sorted({r.clip for r in ours}))}
    theirs = [replace(r, method="theirs", value=r.value + gap + offsets[r.clip]) for r in ours]
    return to_dataframe(ours + theirs)


def test_three_files_are_written(tmp_path):
    files = summary.write(alternating(0.0), tmp_path, draws=100)
    assert [file.name for file in files] == ["summary.md", "summary.csv", "summary.tex"]
    assert sorted(tmp_path.iterdir()) == sorted(files)


@pytest.mark.parametrize("method", ["ntas", "oidn", "mean"])
def test_the_table_has_the_mean_over_scenes(page, method):
    cell = find_line(page, "psnr [dB], mean over scenes", f"| {method} ").split("|")[3]
    assert cell.split()[0] == f"{METHODS[method][0] + OFFSET:.2f}"


def test_only_the_best_is_bold(page):
    section = page[page.index("### psnr [dB], mean over") : page.index("### relmse")]
    assert section.count("**") == 2 * 5
    assert find_line(page, "psnr [dB], mean over", "| ours ").count("**") == 2 * 5


def test_frame_time_is_the_sum_of_its_parts(page):
    cells = find_line(page, "frame time", "| ours | 2 ").split("|")[2:-1]
    sampling = 1.98 * sum(SAMPLE_MS.values()) / 4
    # no G-buffer and no allocation in these results, nor the p95 of their inference
    expected = [2, 1.98, 0, 5.5, 0, sampling, 11, 16.5 + sampling, 16.5]
    assert [float(cell) for cell in cells[:-1]] == pytest.approx(expected, abs=0.005)
    assert cells[-1].strip() == "-"


def test_there_is_a_table_for_each_scene(page):
    titles = re.findall(r"### psnr \[dB\], (.*)", page)
    assert titles == ["mean over scenes", *sorted(SCENES)]


def test_many_scenes_have_no_table_each(tmp_path):
    ours = [r for r in rows(["ours", "ntas"]) if r.metric == "psnr"]
    scenes = [[replace(r, scene=f"scene{i}", clip=f"scene{i}") for r in ours] for i in range(9)]
    few, many = (to_dataframe([r for part in scenes[:n] for r in part]) for n in (8, 9))
    assert write_and_read(few, tmp_path)[0].count("### psnr [dB]") == 9
    assert write_and_read(many, tmp_path)[0].count("### psnr [dB]") == 1


def test_the_csv_has_the_paired_difference(folder):
    keys = ["metric", "scene", "target_spp", "method"]
    row = pd.read_csv(folder / "summary.csv").set_index(keys).loc[("psnr", "all", 1.0, "oidn")]
    assert row["difference"] == pytest.approx(27.5 - 29.9)
    assert (row["clips"], row["frames"], row["best"]) == (8, 32, False)


def test_a_difference_that_is_not_resolved_is_marked(tmp_path):
    text = write_and_read(alternating(-0.01), tmp_path)[0]
    assert find_line(text, "psnr [dB], mean over", "| theirs ").count("not resolved") == 5
    assert find_line(text, "psnr [dB], mean over", "| ours ").count("**") == 10


def test_a_clear_difference_is_resolved(tmp_path):
    assert "not resolved |" not in write_and_read(alternating(-3.0), tmp_path)[0]


def test_skipped_methods_are_listed_with_the_reason(tmp_path):
    measured = rows(["ours"])
    skipped = replace(measured[0], method="restir", value=math.nan, note="no restir pool")
    text = write_and_read(to_dataframe([*measured, skipped]), tmp_path)[0]
    assert "### Not run\n\n- restir on city at 0.5 spp (psnr): no restir pool" in text


def test_a_summary_is_written_without_any_measured_row(tmp_path):
    skipped = replace(rows(["ours"])[0], value=math.nan, note="needs CUDA")
    assert "needs CUDA" in write_and_read(to_dataframe([skipped]), tmp_path)[0]


def test_each_device_has_a_section(tmp_path):
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], device="H100"))
    text = write_and_read(mixed, tmp_path)[0]
    first, second = text.split("## NVIDIA RTX 2080 Ti")
    assert "## H100" in first
    assert ("| ntas" in first, "| ours" in first) == (True, False)
    assert ("| ntas" in second, "| ours" in second) == (False, True)


def test_the_caption_has_the_convention_and_the_direction(page):
    assert "peak 1, clipped sRGB. Higher is better." in page
