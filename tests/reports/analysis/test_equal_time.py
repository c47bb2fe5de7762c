"""Equal time and equal error in closed form, with intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reports.analysis.curves import curves_of
from reports.analysis.equal_time import (
    at_deadlines,
    at_equal_error,
    at_equal_latency,
    crossovers,
    nice_deadlines,
    spp_to_reach,
    with_half_the_samples,
)
from reports.analysis.scores import Scores
from tests.reports.formula_results import THREE, Formula, curve, table


@pytest.fixture(scope="module")
def curves():
    return curves_of(Scores(table(THREE)))


def test_crossovers_are_where_the_closed_form_has_them(curves):
    """Middle leads cheap wherever both fit; slow passes cheap as it fits, and middle at 14.83."""
    (found,) = crossovers(curves, 2.0).to_dict("records")
    assert (found["method"], found["other"], found["other_spp"]) == ("slow", "middle", 4.0)
    numbers = (found["at_ms"], found["spp"], found["value"])
    assert numbers == pytest.approx((12 + 2 * math.sqrt(2), math.sqrt(2), 28.0))


def test_a_crossover_between_two_growing_scores():
    pair = [curve("f", [1, 2, 4], [20, 21, 22], 1), curve("s", [1, 2, 4], [21, 22, 23], 4)]
    (found,) = crossovers(pair, 2.0).to_dict("records")
    assert (found["at_ms"], found["spp"], found["other_spp"]) == pytest.approx((7.0, 1.5, 3.0))
    assert math.isnan(found["low_ms"])  # one scene has no interval


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
    # p95 of plan + denoise is twice its p50
    late = at_deadlines(curves, 2.0, [14.0], late=True).set_index("method")
    assert late["spp"].to_dict() == pytest.approx({"cheap": 4.0, "middle": 2.0})


def test_spp_and_time_to_the_same_error_in_closed_form(curves):
    cheap, middle, slow = curves
    targets = {spp: middle.units_at(np.array(spp)) for spp in (1.0, 2.0, 4.0)}
    rows = at_equal_error([cheap, slow], targets, 2.0).set_index(["method", "target"])
    spp, ms = rows["spp"].to_dict(), rows["frame_ms"].to_dict()
    assert spp["cheap", 1.0] == pytest.approx(4.0)  # 20 + 3 x 2 = 26
    assert ms["cheap", 1.0] == pytest.approx(9.0)
    assert (spp["cheap", 2.0], spp["slow", 1.0]) == (math.inf, 0.0)  # 27.5 at 1 spp is over 26
    assert math.isnan(ms["cheap", 2.0])
    assert spp["slow", 4.0] == pytest.approx(math.sqrt(2))
    assert ms["slow", 4.0] == pytest.approx(12 + 2 * math.sqrt(2))


def test_the_interval_of_a_budget_is_where_that_of_the_difference_includes_zero():
    methods = {"a": Formula(20.0, 1.0, 1.0), "b": Formula(19.5, 1.0, 1.0, 0.02)}
    a, b = curves_of(Scores(table(methods)))
    half = 12.7062 * 0.02  # of two scenes that differ by 0.04 dB
    expected = (2**0.5, 2 ** (0.5 - half), 2 ** (0.5 + half))
    assert tuple(spp_to_reach(b, a.units_at(np.array(1.0)))) == pytest.approx(expected, rel=1e-3)


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
    assert rows[["rival", "spp"]].to_numpy().tolist() == [["ntas", 1.0], ["ntas", 2.0]]
    assert rows["difference"].tolist() == pytest.approx([0.5, 0.5])
    assert rows["speedup"].tolist() == pytest.approx([6 / 6, 10 / 8])


def test_the_time_that_a_small_network_saves_buys_samples():
    methods = {
        "base": Formula(26.0, 1.0, 10.0),
        "small": Formula(25.5, 1.0, 8.0),
        "large": Formula(26.5, 1.0, 13.0),
        "huge": Formula(26.5, 1.0, 90.0),
    }
    found = at_equal_latency(Scores(table(methods)), list(methods), "base")
    found = found.set_index(["method", "base_spp"])
    small, large = found.loc[("small", 1.0)], found.loc[("large", 4.0)]
    assert (small["deadline_ms"], small["spp"], small["share"]) == (12.0, 2.0, 2.0)
    assert small["difference"] == pytest.approx(25.5 + 1.0 - 26.0)
    assert large["spp"] == pytest.approx(2.5)  # 10 + 2 x 4 = 13 + 2 x 2.5
    assert large["value"] == pytest.approx(26.5 + math.log2(2.5))  # linear in log spp
    assert found.loc["huge", ["spp", "value", "difference"]].isna().all(axis=None)
    assert found.loc["small", "is_bound"].tolist() == [False, False, True]  # 5 would fit, 4 is most


def test_deadlines_are_round_and_few(curves):
    assert nice_deadlines(curves, 2.0) == [3, 5, 7, 10, 15, 20]
    assert len(nice_deadlines([curve("a", [1, 4], [1, 2], [0.01, 9000])], 1.0)) <= 7
