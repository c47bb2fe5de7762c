"""Table 1 measured again: numbers computed by hand, orders by scipy, the published numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from reports import table1
from reports.analysis.rows import family_of
from reports.analysis.scores import Scores
from reports.published import published
from reports.table1 import kendall_tau
from rlbench import registry
from rlbench.benchmark.cost_profile import read_profile
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import METHODS, OFFSET, as_published, cells, renamed, rows

TITLE = "Table 1"


@pytest.fixture(scope="module")
def results(published_results):
    """Five methods of the paper's table, and `ours`, whose scores are those of `ours/latent`."""
    return pd.concat([published_results, to_dataframe(rows(["ours"]))], ignore_index=True)


@pytest.fixture(scope="module")
def page(results, tmp_path_factory):
    return table1.write(results, tmp_path_factory.mktemp("table1"))[0].read_text()


def page_of(table, folder):
    return table1.write(to_dataframe(table), folder)[0].read_text()


def test_a_row_has_the_mean_at_each_budget_and_ends_with_the_published_numbers(page):
    """The published differences are those to the row of the paper's own method."""
    for method, (start, slope, *_) in METHODS.items():
        means = [float(cell) for cell in cells(page, TITLE, f"{method} |")[:5]]
        expected = [start + slope * math.log2(spp) + OFFSET for spp in (0.5, 1, 2, 4, 8)]
        assert means == pytest.approx(expected, abs=0.0051)
    for method, printed in {"ntas": (27.7, -1.0, 17.4), "mean": (17, -11.7, 0)}.items():
        assert [float(c) for c in cells(page, TITLE, f"{method} |")[-3:]] == pytest.approx(printed)
    assert cells(page, TITLE, "ours/latent |")[-3:] == ["28.7", "-", "22.5"]
    assert float(cells(page, TITLE, "ours/latent-small")[6]) == pytest.approx(2.2 + 4.5)
    assert "cannot be compared with each other" in page


def test_rows_are_in_the_papers_order_and_other_methods_follow(tmp_path):
    other = renamed(rows(["ours"]), ours="eaw")
    printed = as_published(rows(["mean", "ours"]))
    page = page_of([*other, *rows(["ours"]), *printed], tmp_path)
    names = [x.split("|")[1].strip() for x in page.splitlines() if x.startswith("| ")]
    assert names == ["method", "---", "ours/latent", "mean", "eaw", "ours"]
    assert cells(page, TITLE, "eaw")[-3:] == ["-", "-", "-"]


def test_frames_trained_have_a_column_where_they_are_known(results, page, tmp_path):
    assert "frames trained" not in page
    known = table1.write(results, tmp_path, trained={"ntas": 6000})[0].read_text()
    column = cells(known, TITLE, "method |").index("frames trained")
    assert cells(known, TITLE, "ntas |")[column] == "6,000"
    assert cells(known, TITLE, "mean |")[column] == "-"


def test_what_is_missing_is_listed(page, tmp_path):
    assert "- IMCD, in rlbench imcd\n" in page
    some = [r for r in rows(["ntas", "mean"]) if r.target_spp < 4]
    labelled = renamed(rows(["ours"]), ours="ours/latent@seed1")
    text = page_of([*some, *labelled], tmp_path)
    assert "differences: 'ours' was not measured on every scene" in text
    assert "- 4 spp, the paper's budget" in text
    assert "The orders were not compared: 0 rows are in both." in text
    assert "### Left out: other weights or precision\n\n- ours/latent@seed1" in text
    incomplete = [r for r in rows(["ours", "ntas"]) if r.method == "ours" or r.scene != "hall"]
    text = page_of(as_published(incomplete), tmp_path)
    assert "- ntas at 4 spp: no psnr on hall" in text
    assert "\n| ntas" not in text


def test_the_orders_are_compared_at_the_papers_budget(results, page):
    # of ten pairs, ntas and ours/latent-small are reversed; 10 of 120 orders are as far from zero
    records = table1.compare_with_paper(Scores(results))
    found = table1.rank_correlation(records)
    assert (found.rows, found.tau, found.p_value) == pytest.approx((5, 0.8, 10 / 120))
    # three of five rows lie within 2 dB of the paper's best; one of their pairs is reversed
    strong = table1.rank_correlation(records, within_db=2.0)
    assert (strong.rows, strong.tau) == (3, pytest.approx(1 / 3))
    assert "of the 3 that the paper places within 2 dB of its best: Kendall's tau-b 0.33" in page


def test_a_device_without_published_rows_has_no_section(tmp_path):
    other = [replace(row, method="mine") for row in rows(["ntas"], device="H100")]
    assert "H100" not in page_of(as_published(rows(["ours"])) + other, tmp_path)


TIED = ([3.0, 1.0, 2.0, 2.0, 5.0], [30.0, 11.0, 10.0, 25.0, 24.0])


@pytest.mark.parametrize("seed", range(4))
def test_without_ties_tau_and_p_are_those_of_scipys_exact_test(seed):
    one, other = np.random.default_rng(seed).standard_normal((2, 7))
    ours, scipys = kendall_tau(one, other), stats.kendalltau(one, other, method="exact")
    assert (ours.tau, ours.p_value) == pytest.approx((scipys.statistic, scipys.pvalue))


def test_with_ties_tau_is_tau_b_and_p_the_share_of_all_orders():
    taus = [stats.kendalltau(TIED[0], order).statistic for order in permutations(TIED[1])]
    expected = stats.kendalltau(*TIED).statistic
    found = kendall_tau(*TIED)
    assert found.tau == pytest.approx(expected)
    assert found.p_value == pytest.approx(np.mean([abs(tau) >= expected - 1e-9 for tau in taus]))


def test_random_orders_estimate_the_p_of_all_orders():
    one, other = np.arange(9.0), [1.0, 0, 3, 2, 6, 5, 4, 8, 7]
    exact = stats.kendalltau(one, other, method="exact").pvalue
    error = 4 * math.sqrt(exact / 4000) + 1 / 4e3  # binomial: 4 standard errors of 4000 draws
    assert kendall_tau(one, other, draws=4000).p_value == pytest.approx(exact, abs=error)


@pytest.mark.parametrize("scores", [[], [1.0], [2.0, 2.0]])
def test_scores_without_an_order_have_no_tau(scores):
    found = kendall_tau(scores, scores)
    assert math.isnan(found.tau)
    assert math.isnan(found.p_value)


PRINTED = {row.name: row for row in published().table}


def test_the_published_costs_are_those_of_the_profile_and_their_mean():
    profile, paper = read_profile("paper-2080ti"), published()
    assert (profile.scene_ms, profile.default_ms) == (paper.scene_ms, paper.sample_ms)
    assert sum(paper.scene_ms.values()) / 4 == pytest.approx(paper.sample_ms, abs=0.05)  # rounded


def test_the_published_table_agrees_with_the_gains_and_the_speed_up_in_the_text():
    gains = {"ours-A1": 0.3, "ours-A2": 0.8, "ours-B1": 0.7, "ours-B2": 1.3, "ours-C": 0.5}
    for variant, gain in gains.items():
        assert PRINTED["ours"].psnr_db - PRINTED[variant].psnr_db == pytest.approx(gain)
    other, ours, ms = PRINTED["ReSTIR+OIDN"], PRINTED["ours"], published().sample_ms
    speed_up = (other.inference_ms + 4 * ms) / (ours.inference_ms + 2 * ms)
    assert speed_up == pytest.approx(1.6, abs=0.05)  # printed as 1.6


def test_every_published_row_has_a_family_in_the_registry():
    for row in {p.row for p in published().table}:
        assert registry.load_family(row).name == family_of(row)


def test_only_scores_that_no_table_prints_are_derived():
    derived = [point for point in published().points() if point.derived]
    assert [(p.row, p.spp, p.psnr_db) for p in derived] == [("ours/latent", 2.0, 28.2)]
