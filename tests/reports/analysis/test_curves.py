"""Curves between measured budgets, who wins a deadline, and where that changes."""

from __future__ import annotations

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


@settings(max_examples=100, deadline=None)
@given(any_curve(), TIMES, TIMES)
def test_the_best_budget_never_exceeds_the_deadline(method, sample_ms, deadline_ms):
    spp = method.best_spp(np.array(sample_ms), np.array(deadline_ms))
    fits = method.frame_ms(sample_ms) <= deadline_ms
    assert np.isnan(spp) == (not fits.any())
    if fits.any():
        assert method.frame_ms_at(spp, sample_ms) <= deadline_ms * (1 + 1e-9)


@settings(max_examples=100, deadline=None)
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
