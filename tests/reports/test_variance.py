"""The report on parts of variance: known effects in made-up results."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd
import pytest

from reports import variance
from reports.analysis.scores import Scores
from rlbench.benchmark.results import MissingRowsError, to_dataframe
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


def parts(table):
    return variance.estimate_parts(Scores(to_dataframe(table))).set_index(["row", "minus"])


def test_trainings_and_orders_have_the_deviations_that_were_added():
    row = parts(measured()).loc[("ours@seed", "")]
    assert (row["training"], row["order"]) == pytest.approx((0.2, 0.2 / 2**0.5))
    assert (row["scenes"], row["trainings"], row["orders"]) == (4, 3, 2)
    assert row["rest"] == pytest.approx(0.0, abs=1e-6)


def test_a_difference_to_ours_loses_what_both_have_in_common():
    table = [*measured(), *measured("ntas", "ntas@seed", trainings=(0.1, -0.3, 0.2))]
    row = parts(table).loc[("ntas@seed", "ours")]
    assert row["mean"] == pytest.approx(28.6 - 29.9)
    assert row[["scene", "order"]].tolist() == pytest.approx([0.0, 0.0], abs=1e-6)
    assert row["training"] == pytest.approx(pd.Series([0.3, -0.3, 0.0]).std())


def test_shipped_weights_have_no_part_of_training():
    row = parts(measured(label="ours", trainings=(0.0,))).loc[("ours", "")]
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


def test_one_training_and_one_order_are_not_enough(results, tmp_path):
    with pytest.raises(MissingRowsError, match="rlbench run --draws 4"):
        variance.write(results, tmp_path)
