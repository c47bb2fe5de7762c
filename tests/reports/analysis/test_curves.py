"""Curves between measured budgets, who wins a deadline; equal time and error in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reports.analysis.curves import (
    NOTHING,
    curves_of,
    find_switches,
    find_winners,
    measured_sample_ms,
    methods_without_curve,
)
from reports.analysis.equal_time import (
    at_deadlines,
    at_equal_error,
    at_equal_latency,
    crossovers,
    nice_deadlines,
    spp_to_reach,
    with_half_the_samples,
)
from reports.analysis.intervals import interval_of
from reports.analysis.scores import Scores
from tests.reports.formula_results import THREE, Formula, curve, table

TIMES = st.floats(0.01, 500)


@st.composite
def any_curve(draw):
    spp = sorted(draw(st.sets(st.sampled_from([0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0]), min_size=1)))
    count = {"min_size": len(spp), "max_size": len(spp)}
    values = draw(st.lists(st.floats(-40, 40), **count))  # not monotone
    fixed = draw(st.lists(TIMES, **count))  # nor are the times
    return curve("any", spp, values, fixed, draw(st.sampled_from([1, -1])))


@settings(max_examples=100)
@given(any_curve(), TIMES, TIMES)
def test_the_best_budget_never_exceeds_the_deadline(method, sample_ms, deadline_ms):
    spp = method.best_spp(np.array(sample_ms), np.array(deadline_ms))
    fits = method.frame_ms(sample_ms) <= deadline_ms
    assert np.isnan(spp) == (not fits.any())
    if fits.any():
        assert method.frame_ms_at(spp, sample_ms) <= deadline_ms * (1 + 1e-9)


@settings(max_examples=100)
@given(any_curve(), TIMES, TIMES)
def test_no_budget_of_a_dense_grid_is_better(method, sample_ms, deadline_ms):
    best = method.best_spp(np.array(sample_ms), np.array(deadline_ms))
    positive = method.spp[method.spp > 0]
    grid = np.append(
        method.spp, np.geomspace(positive[0], positive[-1], 400) if len(positive) else 0
    )
    grid = grid.clip(method.spp[0], method.spp[-1])
    grid = grid[method.frame_ms_at(grid, sample_ms) <= deadline_ms]
    if len(grid):
        scores = method.sign * method.value_at(grid)
        assert method.sign * method.value_at(best) >= scores.max() - 1e-6


def test_scores_are_linear_in_log_spp_and_times_in_spp():
    method = curve("a", [1, 4], [20.0, 24.0], [3.0, 6.0])
    assert method.value_at(np.array([1.0, 2.0, 4.0])) == pytest.approx([20, 22, 24])
    assert method.frame_ms_at(np.array([1.0, 2.0, 4.0]), 10.0) == pytest.approx([13, 24, 46])


def test_nothing_is_extrapolated():
    method = curve("a", [1, 4], [20.0, 24.0], 3.0)
    assert np.isnan(method.value_at(np.array([0.99, 4.01]))).all()
    assert np.isnan(method.frame_ms_at(np.array([0.99, 4.01]), 1.0)).all()
    assert method.best_spp(np.array(1.0), np.array(1e6)) == 4
    assert np.isnan(method.best_spp(np.array(1.0), np.array(3.99)))


def test_there_is_nothing_between_no_samples_and_the_next_budget():
    method = curve("a", [0, 1, 2], [5.0, 20.0, 21.0], 1.0)
    assert method.best_spp(np.array(1.0), np.array(1.9)) == 0
    assert method.best_spp(np.array(1.0), np.array(2.5)) == 1.5


def test_a_rising_curve_stays_rising_between_its_points():
    method = curve("a", [0.5, 1, 2, 4, 8], [20, 20, 23, 23.1, 27], 1.0)
    assert (np.diff(method.value_at(np.geomspace(0.5, 8, 500))) >= -1e-12).all()


def test_curves_have_the_times_and_scores_of_the_results():
    curves = {c.method: c for c in curves_of(Scores(table(THREE)))}
    assert list(curves) == ["cheap", "middle", "slow"]
    assert curves["middle"].frame_ms(2.0) == pytest.approx([7, 9, 13])
    assert curves["middle"].frame_ms(2.0, late=True) == pytest.approx([12, 14, 18])
    assert curves["middle"].value_at(np.array([2.0, 3.0])) == pytest.approx([27, 26 + np.log2(3)])


def test_samples_of_a_dearer_pool_count_as_more_path_samples():
    methods = {"path": Formula(20, 1, 1.0), "restir": Formula(22, 1, 1.0, sample_ms=5.0)}
    scores = Scores(table(methods))
    path, restir = curves_of(scores)
    assert measured_sample_ms(scores) == 2.0
    assert path.frame_ms(10.0) == pytest.approx([11, 21, 41])
    assert restir.frame_ms(10.0) == pytest.approx([26, 51, 101])


def test_at_the_cost_in_the_results_frame_times_are_those_of_the_pareto_plot(results):
    scores = Scores(results)
    points = scores.overall.set_index("method")
    for method in curves_of(scores):
        expected = points.loc[method.method].sort_values("target_spp")["frame_ms"]
        assert method.frame_ms(measured_sample_ms(scores)) == pytest.approx(expected.tolist())


def test_an_interval_between_curves_is_the_paired_one(results):
    scores = Scores(results)
    expected = scores.gap("ours", "ntas", 2.0)
    ntas, ours = (c for c in curves_of(scores) if c.method in ("ours", "ntas"))
    gap = interval_of(ours.units_at(np.array(2.0)) - ntas.units_at(np.array(2.0)))
    ends = (expected.mean, expected.low, expected.high)
    assert (gap.mean, gap.low, gap.high) == pytest.approx(ends)


def test_methods_without_a_time_are_named():
    rows = table(THREE)
    untimed = rows[~((rows["method"] == "slow") & (rows["metric"] == "plan_ms"))]
    partial = untimed[~((untimed["method"] == "cheap") & (untimed["scene"] == "hall"))]
    scores = Scores(partial)
    curves = curves_of(scores)
    assert [c.method for c in curves] == ["middle"]
    assert methods_without_curve(scores, curves) == [
        "cheap has no psnr on every scene and frame at any budget",
        "slow has no time on every scene",
    ]


def test_winners_on_a_grid_are_those_of_brute_force():
    generator = np.random.default_rng(3)
    spp = [0.5, 1.0, 2.0, 4.0]
    curves = [
        curve(f"m{i}", spp, np.sort(generator.uniform(15, 30, 4)), generator.uniform(1, 60))
        for i in range(5)
    ]
    costs, deadlines = np.exp(generator.uniform(np.log(0.1), np.log(300), (2, 400)))
    winners = find_winners(curves, costs, deadlines)
    budgets = np.geomspace(0.5, 4, 20_001)
    for place, (cost, deadline) in enumerate(zip(costs, deadlines, strict=True)):
        best, index = -np.inf, NOTHING
        for i, each in enumerate(curves):
            fits = budgets[each.fixed_ms[0] + cost * budgets <= deadline]
            if (
                len(fits)
                and (value := float(np.interp(np.log(fits[-1]), np.log(spp), each.units[:, 0])))
                > best
            ):
                best, index = value, i
        assert winners.first[place] == index


def test_a_switch_is_found_where_the_closed_form_has_it():
    """20 + log2 s after 1 ms and 21 + log2 s after 4 ms are equal where T - 1 = 2 (T - 4)."""
    fast, slow = (
        curve(n, [1, 2, 4], [a, a + 1, a + 2], ms) for n, a, ms in (("f", 20, 1), ("s", 21, 4))
    )

    def leader(deadlines):
        return find_winners([fast, slow], np.full_like(deadlines, 2.0), deadlines).first

    points = [*fast.frame_ms(2.0), *slow.frame_ms(2.0)]
    switches = find_switches(leader, points)
    assert [(s.before, s.after) for s in switches] == [(NOTHING, 0), (0, 1)]
    assert [s.at for s in switches] == pytest.approx([3.0, 7.0])


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
