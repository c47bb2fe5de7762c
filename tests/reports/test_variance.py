"""The report on parts of variance: known effects in made-up results."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from reports import variance
from reports.analysis.scores import Scores
from reports.variance import variance_parts
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import rows

TRAININGS = (-0.2, 0.0, 0.2)  # dB added to the scores of each
ORDERS = (-0.1, 0.1)


def measured(method="ours", label="ours@seed", trainings=TRAININGS, orders=ORDERS):
    psnr = [r for r in rows([method]) if r.metric == "psnr" and r.target_spp == 1]
    return [
        replace(
            r,
            method=f"{label}{i}" if trainings != (0.0,) else label,
            seed=seed,
            value=r.value + training + order,
            weights_hash=f"w{i}",
        )
        for i, training in enumerate(trainings)
        for seed, order in enumerate(orders)
        for r in psnr
    ]


def estimated(table):
    return variance.estimate_parts(Scores(to_dataframe(table))).set_index(["row", "minus"])


def test_trainings_and_orders_have_the_deviations_that_were_added():
    row = estimated(measured()).loc[("ours@seed", "")]
    assert (row["training"], row["order"]) == pytest.approx((0.2, 0.2 / 2**0.5))
    assert (row["scenes"], row["trainings"], row["orders"]) == (4, 3, 2)
    assert row["rest"] == pytest.approx(0.0, abs=1e-6)


def test_a_difference_to_ours_loses_what_both_have_in_common():
    table = [*measured(), *measured("ntas", "ntas@seed", trainings=(0.1, -0.3, 0.2))]
    row = estimated(table).loc[("ntas@seed", "ours")]
    assert row["mean"] == pytest.approx(28.6 - 29.9)
    assert row[["scene", "order"]].tolist() == pytest.approx([0.0, 0.0], abs=1e-6)
    assert row["training"] == pytest.approx(pd.Series([0.3, -0.3, 0.0]).std())


def test_shipped_weights_have_no_part_of_training():
    row = estimated(measured(label="ours", trainings=(0.0,))).loc[("ours", "")]
    assert row["trainings"] == 1
    assert row[["training", "rest"]].isna().all()
    assert row["other_scenes"] > row["same_scenes"] == pytest.approx(0.1)


def test_a_row_with_a_gap_is_left_out():
    table = measured()
    gap = [r for r in table if (r.method, r.seed, r.scene) != ("ours@seed1", 1, "hall")]
    assert variance.estimate_parts(Scores(to_dataframe(gap))).empty


def test_the_page_has_a_table_of_scores_and_one_of_differences(tmp_path):
    table = [*measured(), *measured("ntas", "ntas@seed")]
    page, numbers, tex = variance.write(to_dataframe(table), tmp_path)
    text = page.read_text()
    assert "| ours@seed0, ... | 1 | 4 | 3 | 2 |" in text
    assert "### Parts of variance of the difference to ours" in text
    assert set(pd.read_csv(numbers)["row"]) == {"ours@seed", "ntas@seed"}
    assert "toprule" in tex.read_text()


FACTORS = ("scene", "training", "order")
TRUTH = {  # standard deviations, dB
    ("scene",): 2.0,
    ("training",): 0.5,
    ("order",): 0.3,
    ("scene", "training"): 0.4,
    ("scene", "order"): 0.6,
    ("training", "order"): 0.2,
    FACTORS: 0.1,
}


def simulate(generator, shape):
    total = np.full(shape, 25.0)
    for effect, deviation in TRUTH.items():
        axes = [n if factor in effect else 1 for factor, n in zip(FACTORS, shape, strict=True)]
        total = total + generator.normal(0, deviation, axes)
    return total


def test_estimates_are_unbiased():
    generator, shape = np.random.default_rng(0), (6, 4, 5)
    trials = [variance_parts(simulate(generator, shape), FACTORS).variances for _ in range(800)]
    for effect, deviation in TRUTH.items():
        found = np.array([trial[effect] for trial in trials])
        allowed = 4 * found.std() / math.sqrt(len(found))  # standard errors of the mean
        assert found.mean() == pytest.approx(deviation**2, abs=allowed)


def test_one_factor_has_the_variance_and_standard_error_of_the_sample():
    values = np.array([1.0, 2.0, 4.0, 9.0])
    parts = variance_parts(values, ("scene",))
    assert parts.deviation(("scene",)) == pytest.approx(values.std(ddof=1))
    assert parts.standard_error("scene") == pytest.approx(stats.sem(values))


def test_two_factors_have_the_mean_squares_of_the_classical_table():
    table = np.array([[1.0, 2.0, 6.0], [4.0, 3.0, 9.0], [0.0, 7.0, 5.0], [2.0, 2.0, 8.0]])
    rows, columns = table.mean(1), table.mean(0)
    rest = table - rows[:, None] - columns + table.mean()
    error = (rest**2).sum() / (3 * 2)
    parts = variance_parts(table, ("scene", "order"))
    assert parts.variances[("scene", "order")] == pytest.approx(error)
    assert parts.variances[("scene",)] == pytest.approx((3 * rows.var(ddof=1) - error) / 3)
    assert parts.variances[("order",)] == pytest.approx((4 * columns.var(ddof=1) - error) / 4)


def test_the_standard_error_is_the_scatter_of_means_of_fresh_draws():
    generator, shape = np.random.default_rng(1), (5, 3, 4)
    trials = [simulate(generator, shape) for _ in range(2000)]
    squares = [variance_parts(t, FACTORS).standard_error(*FACTORS) ** 2 for t in trials[:500]]
    scatter = np.var([trial.mean() for trial in trials])
    assert np.mean(squares) == pytest.approx(scatter, rel=0.15)  # 4 standard errors are about 0.13


def test_scenes_that_stay_the_same_add_no_error():
    table = np.array([[1.0, 1.2], [3.0, 3.2]])  # scenes differ by 2, orders by 0.2, nothing else
    parts = variance_parts(table, ("scene", "order"))
    assert parts.standard_error("order") == pytest.approx(0.1)
    assert parts.standard_error("scene", "order") == pytest.approx(math.hypot(0.1, 1.0))


def test_a_factor_with_one_level_is_not_known():
    parts = variance_parts(np.array([[[1.0, 2.0]], [[4.0, 4.5]]]), FACTORS)
    assert parts.levels == {"scene": 2, "order": 2}
    assert math.isnan(parts.deviation(("training",)))
    assert math.isnan(parts.standard_error("training"))


def test_a_gap_in_the_table_is_refused():
    with pytest.raises(ValueError, match="1 of them are nan"):
        variance_parts(np.array([1.0, np.nan]), ("scene",))
