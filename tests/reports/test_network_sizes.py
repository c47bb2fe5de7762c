"""Networks by size at equal samples and at equal time, from formulas with a closed form."""

from __future__ import annotations

import math
from itertools import combinations

import matplotlib as mpl
import pandas as pd
import pytest

from reports import equal_latency, network_study
from reports.analysis.aggregate import Scores
from reports.analysis.network_sizes import SIZES, select_sizes
from reports.layout import style
from reports.layout.size_bars import draw_sizes
from reports.published import published
from rlbench import registry
from rlbench.benchmark.results import MissingRowsError
from tests.reports.formula_results import Formula, table

FORMULAS = {  # 2 ms a sample
    "ours/latent": Formula(26.0, 1.0, 10.0),
    "ours/latent-small": Formula(25.5, 1.0, 8.0, by_scene=0.1),
    "ours/latent-encoder-large": Formula(26.5, 1.0, 13.0),
    "ours/latent-sampler-large": Formula(26.5, 1.0, 90.0),
    "ntas": Formula(24.0, 1.0, 9.0),
}
STUDY = published().network_study


@pytest.fixture(scope="module")
def rows():
    return table(FORMULAS)


@pytest.fixture(scope="module")
def latencies(rows):
    chosen, _ = select_sizes(rows)
    found = equal_latency.measure_sizes(Scores(chosen), draws=100)
    return found.set_index(["method", "base_spp"])


@pytest.fixture(scope="module")
def study(rows, tmp_path_factory):
    return network_study.write(rows, tmp_path_factory.mktemp("study"), draws=100)


def cells(page, title, start):
    section = page[page.index(f"### {title}") :]
    line = next(x for x in section.splitlines() if x.startswith(f"| {start}"))
    return [cell.strip(" *") for cell in line.split("|")[2:-1]]


def test_the_time_that_a_small_network_saves_buys_samples(latencies):
    row = latencies.loc[("ours/latent-small", 1.0)]
    assert (row["deadline_ms"], row["spp"]) == (12.0, 2.0)  # 10 + 2 x 1 = 8 + 2 x 2
    assert row["share"] == 2.0
    assert row["difference"] == pytest.approx(25.5 + 1.0 - 26.0)
    assert row["low"] < row["difference"] < row["high"]


def test_a_large_network_has_fewer_samples_in_the_same_time(latencies):
    row = latencies.loc[("ours/latent-encoder-large", 4.0)]
    assert row["spp"] == pytest.approx(2.5)  # 10 + 2 x 4 = 13 + 2 x 2.5
    assert row["value"] == pytest.approx(26.5 + math.log2(2.5))  # linear in the logarithm of spp


def test_a_network_that_is_slower_than_the_whole_frame_has_no_budget(latencies):
    assert (
        latencies.loc["ours/latent-sampler-large", ["spp", "value", "difference"]]
        .isna()
        .all(axis=None)
    )


def test_budgets_that_were_not_measured_are_a_bound(latencies):
    assert latencies.loc[("ours/latent-small", 4.0), "spp"] == 4.0  # 5 would fit
    assert latencies.loc["ours/latent-small", "is_bound"].tolist() == [False, False, True]
    assert not latencies.loc["ours/latent", "is_bound"].any()


def test_published_samples_are_shares_of_the_published_base(latencies):
    assert latencies.loc[("ours/latent-encoder-large", 1.0), "paper_spp"] == 1.04
    assert latencies.loc[("ours/latent-encoder-large", 1.0), "paper_share"] == pytest.approx(
        1.04 / 1.12
    )
    assert math.isnan(latencies.loc[("ours/latent-small", 1.0), "paper_share"])


def test_the_figure_has_a_panel_for_each_budget_and_one_for_samples(latencies):
    figure = draw_sizes(latencies.reset_index(), SIZES, "caption")
    assert len(figure.axes) == 4
    bars = [bar.get_width() for bar in figure.axes[0].patches]
    assert bars == pytest.approx([0.5])  # at 1 spp only the small network fits
    assert [bar.get_width() for bar in figure.axes[3].patches] == [1.0, 2.0]


def test_no_text_of_the_figure_leaves_it_or_meets_another(latencies):
    with mpl.rc_context(style.RC):
        figure = draw_sizes(latencies.reset_index(), SIZES, "caption")
        figure.draw_without_rendering()
        boxes = [axes.get_tightbbox() for axes in figure.axes]
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.x1 and box.y0 >= 0 for box in boxes)
    numbers = [text for axes in figure.axes for text in axes.texts]
    titles = [axes._left_title for axes in figure.axes]
    labels = [axes.xaxis.label for axes in figure.axes]
    assert all(text.get_text() for text in (*titles, *labels))
    texts = [text.get_window_extent() for text in (*numbers, *titles, *labels)]
    assert not any(a.overlaps(b) for a, b in combinations(texts, 2))


def test_the_files_of_the_figure_are_written(rows, tmp_path):
    files = equal_latency.write(rows, tmp_path, draws=100)
    assert [file.suffix for file in files] == [".png", ".pdf", ".svg", ".csv"]
    assert len(pd.read_csv(files[-1])) == 4 * 3  # sizes of ours, budgets


def test_the_study_sets_times_beside_the_published_ones(study):
    page = study[0].read_text()
    assert cells(page, "Inference", "ours/latent-encoder-large") == [
        "3.2", "9.8", "13.0", "1.30", "2.5", "25.7", "28.2", "1.25",
    ]  # fmt: skip
    assert cells(page, "Inference", "ours/latent-small")[4:] == ["-", "-", "14.4", "0.64"]
    assert cells(page, "Equal time", "ours/latent-small")[:2] == ["2.00", "2.00"]
    assert cells(page, "Equal samples", "ours/latent-small")[0].startswith("-0.50 [")
    assert cells(page, "Equal samples", "ours/latent-small")[-1] == "-1.4"  # 27.3 - 28.7
    assert "ntas" not in page
    assert "- ours/latent-denoiser-small: OIDN's fast network" in page


def test_rows_of_one_label_are_compared_where_there_are_no_others(rows, tmp_path, study):
    brief = rows.assign(method=rows["method"] + "@brief")
    labelled = network_study.write(brief, tmp_path, draws=100)[0].read_text()
    assert "rows @brief" in labelled.splitlines()[0]
    assert labelled.splitlines()[1:] == study[0].read_text().splitlines()[1:]


def test_scores_without_times_have_a_study_and_no_figure(rows, tmp_path):
    untimed = rows[rows["unit"] != "ms"]
    page = network_study.write(untimed, tmp_path, draws=100)[0].read_text()
    assert "### Equal time" not in page
    assert cells(page, "Inference", "ours/latent-small")[:4] == ["-"] * 4
    with pytest.raises(MissingRowsError, match="scores, times and the cost of a sample"):
        equal_latency.write(untimed, tmp_path)


@pytest.mark.parametrize("methods", [["ours/latent", "ntas"], ["ours/latent-small"]])
def test_one_size_is_no_study(rows, methods, tmp_path):
    few = rows[rows["method"].isin(methods)]
    for report in (equal_latency, network_study):
        with pytest.raises(
            MissingRowsError, match="ours/latent and another of ours, ours/latent-small"
        ):
            report.write(few, tmp_path)


@pytest.mark.parametrize("row", SIZES)
def test_every_size_is_a_row_of_the_registry(row):
    assert registry.get_variant(row)


@pytest.mark.parametrize("times", STUDY.rows, ids=lambda times: times.row)
def test_the_published_study_adds_up(times):
    assert times.row in SIZES
    parts = times.sampler_ms + times.encoder_ms + times.denoiser_ms
    assert parts == pytest.approx(times.total_ms)
    spp = (STUDY.frame_ms - times.total_ms) / STUDY.sample_ms
    assert times.spp == pytest.approx(spp, abs=0.011)  # printed to 0.01, some of them cut
