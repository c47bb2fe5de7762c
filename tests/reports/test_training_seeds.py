"""Training seeds: the deviation of table-up trainings, beside the published one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from reports import training_seeds
from reports.analysis.rows import ReportError
from reports.analysis.scores import Scores, mean_over_scenes
from rlbench.benchmark.results import MissingRowsError, to_dataframe
from tests.reports.conftest import OFFSET, SCENES, rows

SHIFTS = (-0.2, 0.1, 0.1)  # dB of each training; mean 0, deviation sqrt(0.06 / 2)


def trained_rows(shifts=SHIFTS, name="ours@seed", method="ours"):
    return [
        replace(r, method=f"{name}{i}", weights_hash=f"{name}{i}", value=r.value + shift)
        for i, shift in enumerate(shifts)
        for r in rows([method])
        if r.metric == "psnr"
    ]


def write_and_read(table, folder):
    return [file.read_text() for file in training_seeds.write(to_dataframe(table), folder)]


def table_rows(page, title="Standard deviation between"):
    (table,) = [part for part in page.split("### ") if part.startswith(title)]
    lines = [x for x in table.splitlines() if x.startswith(("| ours", "| ntas"))]
    return [[cell.strip() for cell in x.split("|")[1:-1]] for x in lines]


@pytest.fixture(scope="module")
def records():
    scores = Scores(to_dataframe(trained_rows()))
    return training_seeds.deviations(scores).set_index("target_spp")


def test_mean_deviation_interval_and_range_are_over_trainings_not_clips_or_frames(records):
    for spp, row in records.iterrows():
        mean = 29.9 + 1.15 * math.log2(spp) + OFFSET
        ends = [math.sqrt(0.06 / stats.chi2(2).ppf(q)) for q in (0.975, 0.025)]
        expected = (mean, math.sqrt(0.03), *ends, mean - 0.2, mean + 0.1, 3)
        assert tuple(row[1:]) == pytest.approx(expected)


def test_the_published_deviation_is_beside_that_of_the_papers_method_only(tmp_path):
    table = trained_rows() + trained_rows(name="ntas@seed", method="ntas")
    table += trained_rows(name="ours/latent@seed")
    rows = table_rows(write_and_read(table, tmp_path)[0])
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
    rows = table_rows(write_and_read(table, tmp_path)[0], "Trainings minus")
    assert [cells[0] for cells in rows] == ["ntas@seed0, ..."]
    assert rows[0][2] == f"**{gap:+.2f} [{gap - half:+.2f}, {gap + half:+.2f}]**"


def test_another_label_is_another_series_which_is_not_compared(tmp_path):
    table = trained_rows() + trained_rows((5.0, 5.0), name="ours@long") + rows(["ours"])
    table += trained_rows((0.0,), name="ntas@seed", method="ntas")
    page = write_and_read(table, tmp_path)[0]
    found = {cells[0]: (cells[2], cells[4][:5]) for cells in table_rows(page) if cells[1] == "1"}
    assert found == {"ours@seed0, ...": ("3", "0.173"), "ours@long0, ...": ("2", "0.000")}
    assert "Trainings minus" not in page
    assert "### Trained once, not listed\n\n- ntas@seed0" in page


def test_a_training_that_lacks_a_scene_is_left_out_and_listed(tmp_path):
    table = [r for r in trained_rows() if (r.method, r.scene) != ("ours@seed2", "hall")]
    page = write_and_read(table, tmp_path)[0]
    assert {cells[2] for cells in table_rows(page)} == {"2"}
    assert "- ours@seed2 at 1 spp: no psnr on hall" in page


def test_folds_of_a_cross_validation_are_no_series(tmp_path):
    """Each fold is scored on its held-out scene, so no two folds have a common scene."""
    folds = dict(zip(SCENES, range(4), strict=True))
    table = [
        r for r in trained_rows((0, 0, 0, 0), "ours@fold") if r.method[-1] == str(folds[r.scene])
    ]
    with pytest.raises(MissingRowsError, match="no method has scores of two trainings"):
        write_and_read(table, tmp_path)


@pytest.mark.parametrize("table", [rows(["ours"]), trained_rows((0.0,))])
def test_results_without_two_trainings_are_refused(table, tmp_path):
    with pytest.raises(MissingRowsError, match="(none|ours@seed0)"):
        write_and_read(table, tmp_path)


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
