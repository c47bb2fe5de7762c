"""Report reference-noise: leads with and without the reference's noise, and ceilings of clips."""

from __future__ import annotations

import math

import pandas as pd
import pytest

from reports.reference_noise import clip_ceilings, measure_leads, write
from rlbench.benchmark.results import NOISE_CEILING, MissingRowsError, Row, to_dataframe
from tests.reports.conftest import SCENES

CEILING = {"city": 30.0, "temple": 28.0, "hall": 26.0, "ripples": 32.0}  # dB
TRUE_PSNR = {"ours": 25.0, "oidn": 24.0, "mean": 12.0}  # dB, without the reference's noise


def plain_psnr(method, scene, frame):
    """PSNR with the noise of the reference: mean squared errors add."""
    errors = (TRUE_PSNR[method] + frame, CEILING[scene])
    return -10 * math.log10(sum(10 ** (-db / 10) for db in errors))


def rows(methods=TRUE_PSNR, spp=1.0, metrics=("psnr", "psnr_debiased", NOISE_CEILING)):
    table = []
    for method in methods:
        for scene in SCENES:
            for frame in (0, 1):
                values = {
                    "psnr": plain_psnr(method, scene, frame),
                    "psnr_debiased": TRUE_PSNR[method] + frame,
                    NOISE_CEILING: CEILING[scene] + frame,
                }
                table += [
                    Row("r", method, scene, scene, spp, spp, frame, m, values[m], "dB", "higher")
                    for m in metrics
                ]
    return table


def lead_over(leads, metric, method):
    return leads.query("metric == @metric and method == @method")["difference"].item()


def test_the_noise_of_references_compresses_a_lead_and_the_debiased_lead_is_the_true_one():
    leads = measure_leads(to_dataframe(rows()), draws=10)
    assert lead_over(leads, "psnr_debiased", "oidn") == pytest.approx(1.0)
    assert 0.5 < lead_over(leads, "psnr", "oidn") < 0.85


def test_leads_are_those_of_ours_or_of_the_best_row_without_it():
    with_ours, without = (
        measure_leads(to_dataframe(rows(names)), draws=10)
        for names in (TRUE_PSNR, ("oidn", "mean"))
    )
    assert set(with_ours["base"]) == {"ours"}
    assert set(without["base"]) == {"oidn"}


def test_each_clip_has_its_ceiling_and_the_best_row_below_it():
    clips = clip_ceilings(to_dataframe([*rows(), *rows(["ours"], spp=4.0)])).set_index("clip")
    assert clips["ceiling"].to_dict() == {scene: db + 0.5 for scene, db in CEILING.items()}
    assert (clips["best"] < clips["ceiling"]).all()
    assert set(clips["best_method"]) == {"ours"}


def test_the_page_has_both_scores_side_by_side_and_the_ceilings(tmp_path):
    page, numbers, _ = write(to_dataframe(rows()), tmp_path, draws=10)
    (line,) = [x for x in page.read_text().splitlines() if x.startswith("| oidn |")]
    plain = sum(plain_psnr("oidn", scene, frame) for scene in SCENES for frame in (0, 1)) / 8
    assert line.startswith(f"| oidn | {plain:.2f} | 24.50 |")
    assert "| hall | 26.50 |" in page.read_text()
    assert len(pd.read_csv(numbers)) == 2 * len(TRUE_PSNR) + len(SCENES)


def test_results_without_half_references_say_what_is_missing(tmp_path):
    with pytest.raises(MissingRowsError, match="two independent halves of the reference"):
        write(to_dataframe(rows(metrics=["psnr"])), tmp_path)
