"""Reports on trainings: deviations beside the published one, and known parts of variance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from reports import training_seeds, variance
from reports.analysis.rows import ReportError
from reports.analysis.scores import Scores, mean_over_scenes
from reports.variance import variance_parts
from rlbench.benchmark.results import MissingRowsError, to_dataframe
from tests.reports.conftest import OFFSET, SCENES, rows, table_rows

TITLE = "Standard deviation between"
SHIFTS = (-0.2, 0.1, 0.1)  # dB of each training; mean 0, deviation sqrt(0.06 / 2)


def trained_rows(shifts=SHIFTS, name="ours@seed", method="ours"):
    return [
        replace(r, method=f"{name}{i}", weights_hash=f"{name}{i}", value=r.value + shift)
        for i, shift in enumerate(shifts)
        for r in rows([method], metric="psnr")
    ]


def write_and_read(table, folder):
    return [file.read_text() for file in training_seeds.write(to_dataframe(table), folder)]


def test_mean_deviation_interval_and_range_are_over_trainings_not_clips_or_frames():
    records = training_seeds.deviations(Scores(to_dataframe(trained_rows())))
    for spp, row in records.set_index("target_spp").iterrows():
        mean = 29.9 + 1.15 * math.log2(spp) + OFFSET
        ends = [math.sqrt(0.06 / stats.chi2(2).ppf(q)) for q in (0.975, 0.025)]
        expected = (mean, math.sqrt(0.03), *ends, mean - 0.2, mean + 0.1, 3)
        assert tuple(row[1:]) == pytest.approx(expected)


def test_the_published_deviation_is_beside_that_of_the_papers_method_only(tmp_path):
    table = trained_rows() + trained_rows(name="ntas@seed", method="ntas")
    table += trained_rows(name="ours/latent@seed")
    rows = table_rows(write_and_read(table, tmp_path)[0], TITLE)[2:]
    assert {(cells[0], cells[-1]) for cells in rows} == {
        ("ours/latent@seed0, ...", "0.06"),
        ("ours@seed0, ...", "-"),
        ("ntas@seed0, ...", "-"),
    }


def test_methods_are_compared_by_welchs_test_over_trainings(tmp_path):
    ours, ntas = SHIFTS, (0.3, -0.1, 0.2, 0.0)
    table = trained_rows() + trained_rows(ntas, name="ntas@seed", method="ntas")
    scores = Scores(to_dataframe(table))
    records = training_seeds.differences_to(mean_over_scenes(scores.scene_means))
    row = records.set_index("target_spp").loc[1.0]
    gap = np.mean(ntas) - np.mean(ours) + 28.6 - 29.9
    variances = [np.var(each, ddof=1) / len(each) for each in (ntas, ours)]
    freedom = sum(variances) ** 2 / sum(
        s**2 / (len(e) - 1) for s, e in zip(variances, (ntas, ours), strict=True)
    )
    half = stats.t(freedom).ppf(0.975) * math.sqrt(sum(variances))
    ends = (row["difference"], row["difference_low"], row["difference_high"])
    assert ends == pytest.approx((gap, gap - half, gap + half))
    page = write_and_read(table, tmp_path)[0]
    assert [row[0] for row in table_rows(page, "Trainings minus")[2:]] == ["ntas@seed0, ..."]
    assert f"**{gap:+.2f} [{gap - half:+.2f}, {gap + half:+.2f}]**" in page


def test_another_label_is_another_series_which_is_not_compared(tmp_path):
    table = trained_rows() + trained_rows((5.0, 5.0), name="ours@long") + rows(["ours"])
    table += trained_rows((0.0,), name="ntas@seed", method="ntas")
    page = write_and_read(table, tmp_path)[0]
    found = {
        cells[0]: (cells[2], cells[4][:5]) for cells in table_rows(page, TITLE) if cells[1] == "1"
    }
    assert found == {"ours@seed0, ...": ("3", "0.173"), "ours@long0, ...": ("2", "0.000")}
    assert "Trainings minus" not in page
    assert "### Trained once, not listed\n\n- ntas@seed0" in page


def test_a_training_that_lacks_a_scene_is_left_out_and_listed(tmp_path):
    table = [r for r in trained_rows() if (r.method, r.scene) != ("ours@seed2", "hall")]
    page = write_and_read(table, tmp_path)[0]
    assert {cells[2] for cells in table_rows(page, TITLE, "ours")} == {"2"}
    assert "- ours@seed2 at 1 spp: no psnr on hall" in page


def test_folds_of_a_cross_validation_are_no_series(tmp_path):
    """Each fold is scored on its held-out scene, so no two folds have a common scene."""
    folds = [
        replace(r, method=f"ours@fold{i}")
        for i, scene in enumerate(SCENES)
        for r in rows(["ours"], metric="psnr", scene=scene)
    ]
    with pytest.raises(MissingRowsError, match="no method has scores of two trainings"):
        write_and_read(folds, tmp_path)


def test_equal_weights_under_two_names_are_refused(tmp_path):
    table = [replace(r, weights_hash="same") for r in trained_rows()]
    with pytest.raises(ReportError, match="ours@seed0 and .* ran with the same weights"):
        write_and_read(table, tmp_path)


def test_the_interval_of_a_deviation_covers_the_truth_at_its_level():
    drawn = np.random.default_rng(1).normal(0, 0.06, (2000, 5))
    is_covered = [
        (d := training_seeds.std_with_interval(five)).low <= 0.06 <= d.high for five in drawn
    ]
    error = 4 * math.sqrt(0.95 * 0.05 / 2000)  # 4 standard errors
    assert np.mean(is_covered) == pytest.approx(0.95, abs=error)
    assert math.isnan(training_seeds.std_with_interval([21.0]).deviation)


TRAININGS = (-0.2, 0.0, 0.2)  # dB added to the scores of each
ORDERS = (-0.1, 0.1)


def measured(method="ours", label="ours@seed", trainings=TRAININGS, orders=ORDERS):
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
        for r in rows([method], metric="psnr", target_spp=1)
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
