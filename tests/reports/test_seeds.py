"""Seeds of training: the spread of made-up trainings, beside the paper's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import SCENES, rows
from scipy import stats

from reports import training_seeds
from reports.analysis import aggregate, training_differences
from rlbench.benchmark.results import MissingRowsError, to_dataframe

SHIFTS = (-0.2, 0.1, 0.1)  # dB of each training; mean 0, deviation sqrt(0.06 / 2)


def trained(shifts=SHIFTS, name="ours@seed", method="ours"):
    return [
        replace(r, method=f"{name}{i}", weights_hash=f"{name}{i}", value=r.value + shift)
        for i, shift in enumerate(shifts)
        for r in rows([method])
        if r.metric == "psnr"
    ]


def written(made, folder):
    return [file.read_text() for file in training_seeds.write(to_dataframe(made), folder)]


def lines(page, title="Deviation between"):
    (grid,) = [part for part in page.split("### ") if part.startswith(title)]
    found = [x for x in grid.splitlines() if x.startswith("| ours") or x.startswith("| ntas")]
    return [[cell.strip() for cell in x.split("|")[1:-1]] for x in found]


@pytest.fixture(scope="module")
def found():
    return training_seeds.deviations(to_dataframe(trained())).set_index("target_spp")


def test_markdown_csv_and_latex_are_written(tmp_path):
    files = training_seeds.write(to_dataframe(trained()), tmp_path)
    assert [file.name for file in files] == ["seeds.md", "seeds.csv", "seeds.tex"]
    assert len(pd.read_csv(files[1])) == 5


@pytest.mark.parametrize("spp", [0.5, 4.0])
def test_the_deviation_is_that_of_the_trainings_not_of_clips_or_frames(found, spp):
    assert found.loc[spp, "deviation"] == pytest.approx(math.sqrt(0.03))


def test_the_interval_is_that_of_chi_square(found):
    ends = [math.sqrt(0.06 / stats.chi2(2).ppf(q)) for q in (0.975, 0.025)]
    assert (found.loc[1, "low"], found.loc[1, "high"]) == pytest.approx(ends)


def test_mean_and_range_are_over_the_trainings(found):
    mean = 29.9 + sum(SCENES.values()) / 4
    row = found.loc[1]
    expected = (mean, mean - 0.2, mean + 0.1, 3)
    assert (row["mean"], row["least"], row["most"], row["trainings"]) == pytest.approx(expected)


def test_the_paper_s_deviation_stands_beside_that_of_ours_alone(tmp_path):
    made = trained() + trained(name="ntas@seed", method="ntas")
    found = lines(written(made, tmp_path)[0])
    assert {(cells[0], cells[-1]) for cells in found} == {
        ("ours@seed0, ...", "0.06"),
        ("ntas@seed0, ...", "-"),
    }


def test_rows_are_compared_over_their_trainings_by_welch_s_test(tmp_path):
    ours, ntas = SHIFTS, (0.3, -0.1, 0.2, 0.0)
    made = trained() + trained(ntas, name="ntas@seed", method="ntas")
    table = to_dataframe(made)
    found = training_differences.differences_to(
        aggregate.overall(aggregate.scene_means(table, "psnr"))
    )
    row = found.set_index("target_spp").loc[1.0]
    gap = np.mean(ntas) - np.mean(ours) + 28.6 - 29.9
    spreads = [np.var(each, ddof=1) / len(each) for each in (ntas, ours)]
    free = sum(spreads) ** 2 / sum(
        s**2 / (len(e) - 1) for s, e in zip(spreads, (ntas, ours), strict=True)
    )
    half = stats.t(free).ppf(0.975) * math.sqrt(sum(spreads))
    ends = (row["difference"], row["difference_low"], row["difference_high"])
    assert ends == pytest.approx((gap, gap - half, gap + half))
    shown = lines(written(made, tmp_path)[0], "Trainings less")
    assert [cells[0] for cells in shown] == ["ntas@seed0, ..."]
    assert shown[0][2] == f"**{gap:+.2f} [{gap - half:+.2f}, {gap + half:+.2f}]**"


def test_trainings_of_other_names_are_not_held_against_each_other(tmp_path):
    made = trained() + trained((0.0, 0.1), name="ntas@long", method="ntas")
    assert "Trainings less" not in written(made, tmp_path)[0]


def test_other_names_are_other_trainings(tmp_path):
    made = trained() + trained((5.0, 5.0), name="ours@long")
    found = lines(written(made, tmp_path)[0])
    spreads = {cells[0]: cells[4].split()[0] for cells in found if cells[1] == "1"}
    assert spreads == {"ours@seed0, ...": "0.173", "ours@long0, ...": "0.000"}


def test_the_shipped_weights_are_no_seed(tmp_path):
    made = trained() + rows(["ours"])
    assert {cells[2] for cells in lines(written(made, tmp_path)[0])} == {"3"}


def test_a_training_alone_is_told(tmp_path):
    made = trained() + trained((0.0,), name="ntas@seed", method="ntas")
    assert "### Trained once, so not shown\n\n- ntas@seed0" in written(made, tmp_path)[0]


def test_a_training_that_lacks_a_scene_is_left_out_and_told(tmp_path):
    made = [r for r in trained() if (r.method, r.scene) != ("ours@seed2", "hall")]
    page = written(made, tmp_path)[0]
    assert {cells[2] for cells in lines(page)} == {"2"}
    assert "- ours@seed2 at 1 spp: no psnr on hall" in page


def test_trainings_that_all_lack_a_scene_have_no_mean_beside_those_that_have_it(tmp_path):
    other = trained(name="ours/A2@seed", method="ours")
    made = trained() + [r for r in other if r.scene != "hall"]
    page = written(made, tmp_path)[0]
    assert {cells[0] for cells in lines(page)} == {"ours@seed0, ..."}
    assert "- ours/A2@seed1 at 1 spp: no psnr on hall" in page


def test_folds_of_a_crossvalidation_are_no_seeds(tmp_path):
    """Each fold is scored on the scene that it was not trained on, so no two can be compared."""
    folds = dict(zip(SCENES, range(4), strict=True))
    made = [r for r in trained((0, 0, 0, 0), "ours@fold") if r.method[-1] == str(folds[r.scene])]
    with pytest.raises(MissingRowsError, match="no row was scored with two trainings"):
        written(made, tmp_path)


@pytest.mark.parametrize("made", [rows(["ours"]), trained((0.0,))])
def test_a_table_without_two_trainings_is_refused(made, tmp_path):
    with pytest.raises(MissingRowsError, match="rows of named weights are: (none|ours@seed0)"):
        written(made, tmp_path)


def test_equal_weights_under_two_names_are_refused(tmp_path):
    made = [replace(r, weights_hash="same") for r in trained()]
    with pytest.raises(aggregate.ReportError, match="ours@seed0 and .* ran with the same weights"):
        written(made, tmp_path)


def test_latex_escapes_what_it_must(tmp_path):
    tex = written(trained(name="ours@s_"), tmp_path)[2]
    assert r"ours@s\_0, ... & 0.5 & 3 &" in tex
