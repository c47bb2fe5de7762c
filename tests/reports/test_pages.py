"""Pages with a table of scores: summary, clips, effort, noise of references, equal time, parts."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pandas as pd
import pytest

from reports import effort, equal_time, parts, per_clip, reference_noise, summary
from reports.analysis.scores import Scores
from rlbench import registry
from rlbench.benchmark.results import COUNT_PREFIX, NOISE_CEILING, WHOLE_CLIP, Row, to_dataframe
from tests.reports.conftest import METHODS, OFFSET, SAMPLE_MS, SCENES, cells, psnr, rows
from tests.reports.formula_results import Formula, table


@pytest.fixture(scope="module")
def summary_page(results, tmp_path_factory):
    return summary.write(results, tmp_path_factory.mktemp("summary"))[0].read_text()


def test_summary_has_means_frame_times_scenes_and_one_bold_row(summary_page):
    for method in ("ntas", "oidn", "mean"):
        (mean, *_) = cells(summary_page, "PSNR [dB], mean over scenes", f"{method} ")[1].split()
        assert mean == f"{METHODS[method][0] + OFFSET:.2f}"
    line = cells(summary_page, "frame time", "ours | 2 ")
    sampling = 1.98 * sum(SAMPLE_MS.values()) / 4
    expected = [2, 1.98, 0, 5.5, 0, sampling, 11, 16.5 + sampling, 16.5, 1.2 * 16.5]
    assert [float(cell) for cell in line] == pytest.approx(expected, abs=0.005)
    titles = re.findall(r"### PSNR \[dB\], (.*)", summary_page)
    assert titles == ["mean over scenes", *sorted(SCENES)]
    section = summary_page[summary_page.index("### PSNR [dB], mean over") :].split("\n###")[0]
    assert section.count("**") == 2 * 5
    assert "peak 1, clipped sRGB. Higher is better." in summary_page
    assert "Unreliable times" not in summary_page


def test_summary_lists_what_was_not_run_and_metrics_that_are_equal_for_all(tmp_path):
    measured = rows(["ours", "ntas"])
    skipped = replace(measured[0], method="restir", value=math.nan, note="no restir pool")
    equal = [replace(r, metric="nonfinite", value=0.0, unit="") for r in measured if r.frame == 0]
    page = summary.write(to_dataframe([*measured, skipped, *equal]), tmp_path)[0].read_text()
    assert "### Not run\n\n- restir on city at 0.5 spp (psnr): no restir pool" in page
    assert "0 for all 2 methods" in page
    page = summary.write(to_dataframe([skipped]), tmp_path)[0].read_text()
    assert "no restir pool" in page


@pytest.mark.parametrize(
    ("report", "title", "scenes", "tables"),
    [
        (summary, "PSNR [dB]", 8, 9),
        (summary, "PSNR [dB]", 9, 1),
        (per_clip, "PSNR [dB] at", 8, 1),
        (per_clip, "PSNR [dB] at", 9, 0),
    ],
)
def test_many_scenes_or_clips_are_in_the_csv_alone(report, title, scenes, tables, tmp_path):
    city = rows(["ours", "ntas"], metric="psnr", scene="city", target_spp=1)
    many = [replace(r, scene=f"s{i}", clip=f"s{i}-{r.clip}") for i in range(scenes) for r in city]
    page, data, *_ = report.write(to_dataframe(many), tmp_path)
    assert page.read_text().count(f"### {title}") == tables
    assert "s0" in data.read_text()


def test_clips_have_a_row_each_the_best_first_and_the_difference_to_ours(results, tmp_path):
    page = per_clip.write(results, tmp_path)[0].read_text()
    header = cells(page, "PSNR [dB] at 4 spp", "clip")
    assert header == ["ours", "ours/latent-small", "ntas", "oidn", "mean"]
    expected = sum(psnr("ntas", "hall", 4, clip=1, frame=f) for f in range(4)) / 4
    assert cells(page, "PSNR [dB] at 4 spp", "hall-1")[2] == f"{expected:.2f}"
    assert cells(page, per_clip.MEANS, "ours ")[1] == f"{METHODS['ours'][0] + OFFSET:.2f}"
    assert cells(page, "PSNR [dB], minus ours", "ntas")[1].startswith("-1.30 [-1.3")


@pytest.mark.parametrize(("methods", "scenes"), [(16, 1), (17, 0)])
def test_a_summary_of_many_methods_is_brief(methods, scenes, tmp_path):
    ours = [r for r in rows(["ours"], scene="city") if r.target_spp <= 1]
    many = [replace(r, method=f"m{i:02}", value=r.value + i) for i in range(methods) for r in ours]
    page, data, *_ = summary.write(to_dataframe(many), tmp_path)
    text = page.read_text()
    assert text.count("### PSNR [dB], city") == scenes
    assert ("### relMSE" in text) == bool(scenes)
    assert "relmse" in set(pd.read_csv(data)["metric"])
    assert (text.count("| m00 | 0.5 |"), text.count("| m00 | 1 |")) == (scenes, 1)


def test_without_ours_clips_are_compared_with_the_best_and_incomplete_methods_come_last(tmp_path):
    some = [r for r in rows(("oidn", "ntas")) if (r.method, r.scene) != ("ntas", "hall")]
    page = per_clip.write(to_dataframe(some), tmp_path)[0].read_text()
    assert cells(page, "PSNR [dB] at 2 spp", "clip") == ["oidn", "ntas"]
    assert cells(page, "PSNR [dB] at 2 spp", "hall-0")[1] == "-"
    assert "| ntas" not in page.split("### PSNR [dB] at")[0]


def counted(method, scene, shares, **metrics):
    """A histogram in percent of a cell, and metrics of frames 0 and 1."""

    def row(frame, metric, value):
        return Row("r", method, scene, scene, 1.0, 1.0, frame, metric, value)

    given = {"effort_noise": 0.5, "effort_error": 0.1, "at_cap": 2.0, **metrics}
    return [
        *(row(WHOLE_CLIP, f"{COUNT_PREFIX}{n}", share) for n, share in enumerate(shares)),
        *(row(frame, name, value) for frame in (0, 1) for name, value in given.items()),
    ]


ADAPTIVE = [
    *counted("a", "city", [30.0, 50.0, 10.0, 10.0], at_cap=4.0),
    *counted("a", "hall", [10.0, 80.0, 10.0, 0.0], at_cap=0.0),
]
OTHERS = [
    *(r for s in ("city", "hall") for r in counted("capped", s, [25.0, 50.0, 25.0])),
    *(r for s in ("city", "hall") for r in counted("mean", s, [0.0, 100.0])),
]


def test_effort_has_the_shares_of_rows_that_adapt(tmp_path):
    scores = Scores(to_dataframe([*ADAPTIVE, *OTHERS]))
    shares = effort.count_shares(scores).set_index("method")
    assert shares.loc["a", ["0", "1", "2", "3"]].tolist() == [20, 65, 10, 5]
    assert shares.loc["capped", ["0", "1", "2", "3"]].tolist() == [25, 50, 25, 0]
    assert "mean" not in shares.index
    page = effort.write(scores.rows, tmp_path)[0].read_text()
    assert "| a | 1 | 0.50 | 0.10 | 2.00 | 4.00 | 0.00 |" in page


CEILING = {"city": 30.0, "temple": 28.0, "hall": 26.0, "ripples": 32.0}  # dB
TRUE_PSNR = {"ours": 25.0, "oidn": 24.0, "mean": 12.0}  # dB, without the reference's noise


def noisy_rows(methods=TRUE_PSNR):
    """PSNR with the noise of the reference: mean squared errors add."""
    for method in methods:
        for scene, ceiling in CEILING.items():
            for frame in (0, 1):
                errors = (TRUE_PSNR[method] + frame, ceiling)
                plain = -10 * math.log10(sum(10 ** (-db / 10) for db in errors))
                values = {"psnr": plain, "psnr_debiased": TRUE_PSNR[method] + frame}
                for metric, value in (values | {NOISE_CEILING: ceiling + frame}).items():
                    place = (method, scene, scene, 1.0, 1.0, frame)
                    yield Row("r", *place, metric, value, "dB", "higher")


def test_the_noise_of_references_compresses_a_lead_and_the_debiased_lead_is_the_true_one():
    leads = reference_noise.measure_leads(Scores(to_dataframe(list(noisy_rows()))))
    of_oidn = leads[leads["method"] == "oidn"].set_index("metric")
    assert of_oidn.loc["psnr_debiased", "difference"] == pytest.approx(1.0)
    assert 0.5 < of_oidn.loc["psnr", "difference"] < 0.85
    assert set(leads["base"]) == {"ours"}
    without = Scores(to_dataframe(list(noisy_rows(("oidn", "mean")))))
    assert set(reference_noise.measure_leads(without)["base"]) == {"oidn"}


def test_each_clip_has_its_ceiling_and_the_best_row_below_it(tmp_path):
    results = to_dataframe(list(noisy_rows()))
    clips = reference_noise.clip_ceilings(Scores(results)).set_index("clip")
    assert clips["ceiling"].to_dict() == {scene: db + 0.5 for scene, db in CEILING.items()}
    assert (clips["best"] < clips["ceiling"]).all()
    page, numbers, _ = reference_noise.write(results, tmp_path)
    assert "| hall | 26.50 |" in page.read_text()
    assert len(pd.read_csv(numbers)) == 2 * len(TRUE_PSNR) + len(SCENES)


def test_equal_time_has_every_table_and_the_paper_as_a_row(results, tmp_path):
    page, csv, _ = equal_time.write(results, tmp_path)
    printed = "| paper: ours at 2 spp | ReSTIR+OIDN at 4 spp | +0.2 | 75.1 | 123.5 | 1.64 |"
    assert printed in page.read_text()
    assert pd.read_csv(csv)["table"].nunique() == 7
    other = equal_time.write(results, tmp_path, base="ntas")[0].read_text()
    assert "ntas against the best method of another family" in other
    assert "| paper: " not in other


def test_effective_spp_are_samples_of_the_reference(tmp_path):
    methods = {"mean": Formula(17.0, 3.0, 0.0), "ours": Formula(20.0, 1.0, 5.0)}
    page = equal_time.write(table(methods), tmp_path)[0].read_text()
    # 20, 21 and 22 dB are 2 ** (3/3), 2 ** (4/3) and 2 ** (5/3) samples
    found = [float(cell.split()[0]) for cell in cells(page, "Effective spp", "ours")]
    assert found == pytest.approx([2.0, 2.52, 3.17])


PART_FORMULAS = {  # 2 ms a sample
    "ours": Formula(26.0, 1.0, 10.0),
    "ours/by-rule": Formula(25.75, 1.0, 8.0, by_scene=0.1),
    "accumulate/contrast": Formula(26.5, 1.0, 90.0),
    "ntas": Formula(24.0, 1.0, 9.0),
}


def test_parts_are_compared_at_equal_samples_at_equal_time_and_on_first_frames(tmp_path):
    results = table(PART_FORMULAS)
    is_first = (results["frame"] == 0) & (results["metric"] == "psnr")
    results.loc[is_first & (results["method"] == "ours/by-rule"), "value"] += 2.0
    page = parts.write(results, tmp_path)[0].read_text()
    assert cells(page, "Equal samples", "ours/by-rule")[0].startswith("+0.75 [")  # -0.25 + 2 / 2
    assert cells(page, "Equal time", "ours/by-rule")[0].startswith("+1.75 [")  # a doubling more
    samples = cells(page, "Samples at equal time", "ours/by-rule")
    assert samples == ["2.00", "3.00", ">= 4.00"]  # 10 + 2 x 1 = 8 + 2 x 2; 5 would fit
    assert cells(page, "First frame", "ours/by-rule")[0].startswith("+1.75 [")  # -0.25 + 2
    section = page[page.index("### Equal time") : page.index("### First frame")]
    assert "accumulate/contrast" not in section  # slower than the whole frame
    assert "ntas" not in page
    assert "- oidn/tuned: memory and density" in page
    untimed = parts.write(results[results["metric"] == "psnr"], tmp_path)[0].read_text()
    assert "### Equal time" not in untimed


def test_every_part_is_a_row_of_the_registry():
    assert all(registry.get_variant(row) for row in (parts.BASE, *parts.PARTS))
