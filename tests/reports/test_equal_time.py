"""Equal time and equal error: closed forms, intervals, and the headline of the paper."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from reports import equal_time
from reports.analysis.curves import curves_of
from reports.analysis.equal_time import (
    at_deadlines,
    at_equal_error,
    crossovers,
    nice_deadlines,
    spp_to_reach,
    with_half_the_samples,
)
from reports.analysis.scores import Scores
from rlbench.benchmark.results import MissingRowsError
from tests.reports.formula_results import THREE, Formula, curve, table


@pytest.fixture(scope="module")
def curves():
    return curves_of(Scores(table(THREE)))


def test_crossovers_are_where_the_closed_form_has_them(curves):
    """Middle leads cheap wherever both fit; slow passes cheap as it fits, and middle at 14.83."""
    found = crossovers(curves, 2.0)
    assert [(row.method, row.other) for row in found.itertuples()] == [("slow", "middle")]
    assert found["at_ms"].tolist() == pytest.approx([12 + 2 * math.sqrt(2)])
    assert found["spp"].tolist() == pytest.approx([math.sqrt(2)])
    assert found["value"].tolist() == pytest.approx([28.0])
    assert found["other_spp"].tolist() == [4.0]


def test_a_crossover_between_two_growing_scores():
    pair = [curve("f", [1, 2, 4], [20, 21, 22], 1), curve("s", [1, 2, 4], [21, 22, 23], 4)]
    found = crossovers(pair, 2.0)
    assert found["at_ms"].tolist() == pytest.approx([7.0])
    assert found["spp"].tolist() == pytest.approx([1.5])
    assert found["other_spp"].tolist() == pytest.approx([3.0])
    assert found["low_ms"].isna().all()  # one scene has no interval


def test_a_crossover_has_the_times_that_are_not_resolved():
    close = {"a": Formula(20.0, 1.0, 1.0, 0.02), "b": Formula(20.0, 2.0, 2.0)}
    wide = {"a": Formula(20.0, 1.0, 1.0, 3.0), "b": Formula(20.0, 2.0, 2.0)}
    narrow, unclear = (
        crossovers(curves_of(Scores(table(methods))), 2.0).iloc[0] for methods in (close, wide)
    )
    # 2 log2((T - 2) / 2) = log2((T - 1) / 2)
    assert narrow["at_ms"] == pytest.approx(3 + math.sqrt(3))
    assert 0 < narrow["low_ms"] < narrow["at_ms"] < narrow["high_ms"] < math.inf
    assert (unclear["low_ms"], unclear["high_ms"]) == (0.0, math.inf)


def test_each_method_has_its_best_budget_within_a_deadline(curves):
    rows = at_deadlines(curves, 2.0, [11.0]).set_index("method")
    assert rows["spp"].to_dict() == pytest.approx({"cheap": 4.0, "middle": 3.0})
    assert rows["best"].to_dict() == {"cheap": False, "middle": True}
    assert rows.loc["cheap", "difference"] == pytest.approx(-math.log2(3))


def test_a_deadline_that_95_percent_meet_leaves_less_time(curves):
    rows = at_deadlines(curves, 2.0, [14.0], late=True).set_index("method")
    # p95 of plan + denoise is twice its p50
    assert rows["spp"].to_dict() == pytest.approx({"cheap": 4.0, "middle": 2.0})


def test_spp_and_time_to_the_same_error_in_closed_form(curves):
    cheap, middle, slow = curves
    targets = {spp: middle.units_at(np.array(spp)) for spp in (1.0, 2.0, 4.0)}
    rows = at_equal_error([cheap, slow], targets, 2.0).set_index(["method", "target"])
    assert rows.loc[("cheap", 1.0), "spp"] == pytest.approx(4.0)  # 20 + 3 x 2 = 26
    assert rows.loc[("cheap", 1.0), "frame_ms"] == pytest.approx(9.0)
    assert rows.loc[("cheap", 2.0), "spp"] == math.inf
    assert math.isnan(rows.loc[("cheap", 2.0), "frame_ms"])
    assert rows.loc[("slow", 1.0), "spp"] == 0.0  # 27.5 at 1 spp is more than 26
    assert rows.loc[("slow", 4.0), "spp"] == pytest.approx(math.sqrt(2))
    assert rows.loc[("slow", 4.0), "frame_ms"] == pytest.approx(12 + 2 * math.sqrt(2))


def test_the_interval_of_a_budget_is_where_that_of_the_difference_includes_zero():
    base = Formula(20.0, 1.0, 1.0)
    a, b = curves_of(Scores(table({"a": base, "b": Formula(19.5, 1.0, 1.0, 0.02)})))
    reach = spp_to_reach(b, a.units_at(np.array(1.0)))
    half = 12.7062 * 0.02  # of two scenes that differ by 0.04 dB
    assert reach.spp == pytest.approx(2**0.5, rel=1e-3)
    assert (reach.low, reach.high) == pytest.approx(
        (2 ** (0.5 - half), 2 ** (0.5 + half)), rel=1e-3
    )


def test_half_the_samples_are_compared_with_the_best_rival_of_another_family():
    methods = {
        "ours": Formula(24.0, 1.0, 4.0),
        "ours/A2": Formula(25.0, 1.0, 4.0),
        "ntas": Formula(22.5, 1.0, 2.0),
        "svgf": Formula(20.0, 1.0, 1.0),
    }
    curves = curves_of(Scores(table(methods)))
    base = next(each for each in curves if each.method == "ours")
    rows = with_half_the_samples(curves, base, 2.0)
    assert rows["rival"].tolist() == ["ntas", "ntas"]
    assert rows["spp"].tolist() == [1.0, 2.0]
    assert rows["difference"].tolist() == pytest.approx([0.5, 0.5])
    assert rows["speedup"].tolist() == pytest.approx([6 / 6, 10 / 8])


def test_deadlines_are_round_and_few(curves):
    deadlines = nice_deadlines(curves, 2.0)
    assert deadlines == [3, 5, 7, 10, 15, 20]
    assert len(nice_deadlines([curve("a", [1, 4], [1, 2], [0.01, 9000])], 1.0)) <= 7


@pytest.fixture(scope="module")
def page(results, tmp_path_factory):
    return equal_time.write(results, tmp_path_factory.mktemp("equal"), draws=200)


def test_the_page_has_every_table_and_the_paper_as_a_row(page):
    text = page[0].read_text()
    titles = [line[4:] for line in text.splitlines() if line.startswith("### ")]
    assert titles[:8] == [
        "Half the samples",
        "Equal time",
        "Quality at a deadline that 95 % of frames meet",
        "Samples to the error of ours",
        "Time to the error of ours",
        "Time to a given PSNR",
        "Effective spp, in samples of mean",
        "Crossovers",
    ]
    assert "| paper: ours at 2 spp | ReSTIR+OIDN at 4 spp | +0.2 | 75.1 | 123.5 | 1.64 |" in text
    assert [file.suffix for file in page] == [".md", ".csv", ".tex"]


def test_the_papers_row_is_for_a_base_of_its_family_alone(results, tmp_path):
    text = equal_time.write(results, tmp_path, base="ntas", draws=100)[0].read_text()
    assert "ntas against the best method of another family" in text
    assert "| paper: " not in text


def test_the_csv_has_the_numbers_of_every_table(page):
    tables = pd.read_csv(page[1])["table"].unique()
    assert set(tables) == {
        "half the samples", "equal time", "deadline", "equal error", "given error",
        "effective spp", "crossover",
    }  # fmt: skip


def test_effective_spp_are_samples_of_the_reference(tmp_path):
    methods = {"mean": Formula(17.0, 3.0, 0.0), "ours": Formula(20.0, 1.0, 5.0)}
    text = equal_time.write(table(methods), tmp_path)[0].read_text()
    part = text.split("Effective spp")[1].split("###")[0]
    # 20, 21 and 22 dB are 2 ** (3/3), 2 ** (4/3) and 2 ** (5/3) samples
    row = next(line for line in part.splitlines() if line.startswith("| ours"))
    cells = [float(cell.split()[0]) for cell in row.split("|")[2:-1]]
    assert cells == pytest.approx([2.0, 2.52, 3.17])


def test_results_without_times_have_no_page(tmp_path):
    rows = table(THREE)
    with pytest.raises(MissingRowsError, match="equal times need psnr, plan_ms"):
        equal_time.write(rows[rows["unit"] != "ms"], tmp_path)
