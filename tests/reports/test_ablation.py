"""The ablation tables: pairs counted by hand, and differences known from formulas."""

from __future__ import annotations

import io
import math
from dataclasses import replace

import pandas as pd
import pytest

from reports import ablation
from reports.analysis import variant_differences
from reports.analysis.rows import ReportError, split_by_device
from reports.analysis.scores import Scores
from rlbench.benchmark.results import MissingRowsError, to_dataframe
from tests.reports.conftest import SCENES, rows

SETTINGS = {
    "ours": '{"bptt": 1, "sampler": [4, 8]}',
    "ours/latent-small": '{"bptt": 1, "sampler": []}',
}


def rows_with_configs(methods=("ours", "ours/latent-small")):
    return [replace(r, config=SETTINGS[r.method]) for r in rows(methods)]


def rename_method(table, method):
    return [replace(r, method=method) for r in table]


def copies(*methods):
    """The rows of `ours` under each of these names."""
    return [r for method in methods for r in rename_method(rows(["ours"]), method)]


def differences(scores, draws):
    return variant_differences.differences(scores, "ours", ["ours/latent-small"], draws=draws)


def write_and_read(table, folder, **options):
    return [file.read_text() for file in ablation.write(table, folder, draws=200, **options)]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return write_and_read(to_dataframe(rows_with_configs()), tmp_path_factory.mktemp("ablation"))[0]


@pytest.fixture(scope="module")
def records(results):
    return differences(Scores(results), draws=200).set_index(["method", "target_spp"])


def cells(page, title, start):
    section = page[page.index(f"### {title}") :]
    line = next(x for x in section.splitlines() if x.startswith(f"| {start} "))
    return [cell.strip() for cell in line.split("|")[2:-1]]


def test_rows_with_one_label_are_compared_if_no_other_rows_exist(page, tmp_path):
    brief = [replace(r, method=f"{r.method}@brief") for r in rows_with_configs()]
    (labelled, *_) = write_and_read(to_dataframe([*brief, *rows(("mean",))]), tmp_path)
    assert "rows @brief" in labelled.splitlines()[0]
    assert labelled.splitlines()[1:] == page.splitlines()[1:]


def test_markdown_csv_and_latex_are_write_and_read(results, tmp_path):
    files = ablation.write(results, tmp_path, draws=10)
    assert [file.name for file in files] == ["ablation.md", "ablation.csv", "ablation.tex"]


@pytest.mark.parametrize("spp", [0.5, 1, 2, 4, 8])
def test_the_difference_is_that_of_the_formulas(records, spp):
    expected = 29.2 - 29.9 + (1.1 - 1.15) * math.log2(spp)
    assert records.loc[("ours/latent-small", spp), "difference"] == pytest.approx(expected)


def test_every_clip_and_frame_is_a_pair(records):
    row = records.loc[("ours/latent-small", 4)]
    assert (row["pairs"], row["unpaired"], row["units"]) == (4 * 2 * 4, 0, 4)


def test_the_interval_of_one_scene_is_over_its_clips():
    city = to_dataframe([r for r in rows_with_configs() if r.scene == "city"])
    row = differences(Scores(city), draws=500).set_index("target_spp").loc[1.0]
    half = 12.7062 * 0.06  # Student's t of its two clips, which have -0.76 and -0.64
    assert (row["low"], row["high"]) == pytest.approx((-0.7 - half, -0.7 + half), rel=1e-4)


def test_the_time_difference_is_that_of_plan_and_denoise_at_equal_samples(records):
    assert records.loc[("ours/latent-small", 2), "frame_ms"] == pytest.approx(
        2.2 + 4.5 - 5.5 - 11.0
    )


def test_scores_without_a_partner_are_left_out_and_listed(tmp_path):
    both = rows_with_configs()
    outliers = [
        replace(r, seed=1, value=r.value + 50)
        for r in both
        if r.method == "ours/latent-small" and r.metric == "psnr"
    ]
    table = to_dataframe([*both, *outliers])
    row = differences(Scores(table), draws=10).set_index("target_spp").loc[1.0]
    assert row["difference"] == pytest.approx(-0.7)
    line = "- ours/latent-small at 1 spp: 32 scores without a partner, 32 pairs"
    assert line in write_and_read(table, tmp_path)[0]


def test_scores_of_one_seed_are_paired():
    """The seeds differ by 10 dB, the variants by 1 dB: every pair of one seed differs by 1 dB."""
    base = [r for r in rows_with_configs(["ours"]) if r.metric == "psnr" and r.target_spp == 1]
    seeded = [replace(r, seed=s, value=10.0 * s) for r in base for s in (0, 1)]
    more = [replace(r, method="ours/latent-small", value=r.value + 1) for r in seeded]
    scores = Scores(to_dataframe([*seeded, *more]))
    row = differences(scores, draws=100).iloc[0]
    assert (row["difference"], row["low"], row["high"]) == (1, 1, 1)
    assert row["pairs"] == 64


def test_a_difference_whose_interval_excludes_zero_is_bold(page):
    assert all(
        cell.startswith("**-") for cell in cells(page, "PSNR minus", "ours/latent-small")[:5]
    )


def test_a_difference_whose_interval_includes_zero_is_not_bold(tmp_path):
    base = [r for r in rows_with_configs(["ours"]) if r.metric == "psnr"]
    ends = {clip: 1 - 2 * (i % 2) for i, clip in enumerate(sorted({r.clip for r in base}))}
    alternating = [replace(r, method="ours/A9", value=r.value + ends[r.clip]) for r in base]
    page = write_and_read(to_dataframe([*base, *alternating]), tmp_path)[0]
    assert "**" not in page


def test_the_published_difference_is_in_the_last_column(tmp_path):
    table = [*rows(("ours", "ours/latent-small")), *copies("ours/latent")]
    page = write_and_read(to_dataframe(table), tmp_path)[0]
    row = cells(page, "PSNR minus that of ours/latent", "ours/latent-small")
    assert row[-1] == "-1.4"  # 27.3 - 28.7
    assert len(row) == 5 + 1
    assert len(cells(page, "PSNR minus that of ours\n", "ours/latent")) == 5  # no such row in print


def test_a_variant_of_a_part_is_compared_with_the_part_where_that_was_scored():
    scored = ["ours/latent-sampler-small", "ours/latent-A1", "ours/latent", "ours/A1", "ours"]
    assert variant_differences.group_by_base(scored) == {
        "ours": ["ours/A1", "ours/latent"],
        "ours/latent": ["ours/latent-A1", "ours/latent-sampler-small"],
    }


def test_a_variant_of_a_part_is_compared_with_the_main_variant_if_the_part_was_not_scored():
    scored = ["ours/paper-A1", "ours/by-rule", "ours", "ours/latent-A1"]
    assert variant_differences.group_by_base(scored) == {
        "ours": ["ours/by-rule", "ours/latent-A1", "ours/paper-A1"]
    }


def test_a_page_has_tables_for_each_row_that_others_change(tmp_path):
    methods = ("ours", "ours/A1", "ours/latent", "ours/latent-A1", "ours/paper", "ours/paper-A1")
    page, csv, _ = write_and_read(to_dataframe(copies(*methods)), tmp_path)
    bases = ("ours", "ours/latent", "ours/paper")
    titles = ("PSNR minus that of {}", "Frame time minus that of {}")
    titles = (*titles, "Changed settings of {}, and pairs")
    headings = [line[4:] for line in page.splitlines() if line.startswith("### ")]
    assert headings[:9] == [title.format(base) for title in titles for base in bases]
    records = pd.read_csv(io.StringIO(csv))
    assert dict(zip(records["method"], records["base"], strict=True)) == {
        "ours/A1": "ours",
        "ours/latent": "ours",
        "ours/paper": "ours",
        "ours/latent-A1": "ours/latent",
        "ours/paper-A1": "ours/paper",
    }


def test_the_score_of_a_variant_of_a_part_is_subtracted_from_that_of_the_part(tmp_path):
    """The part is 2 dB better than the main variant, its variant 3 dB better."""
    shift = {"ours": 0.0, "ours/latent": 2.0, "ours/latent-A1": 3.0}
    scores = [r for r in copies(*shift) if r.metric == "psnr"]
    table = [replace(r, value=r.value + shift[r.method]) for r in scores]
    page = write_and_read(to_dataframe(table), tmp_path / "with")[0]
    assert cells(page, "PSNR minus that of ours\n", "ours/latent")[0].startswith("**+2.00 ")
    assert cells(page, "PSNR minus that of ours/latent", "ours/latent-A1")[0].startswith("**+1.00 ")
    without = [r for r in table if r.method != "ours/latent"]
    page = write_and_read(to_dataframe(without), tmp_path / "without")[0]
    assert cells(page, "PSNR minus that of ours\n", "ours/latent-A1")[0].startswith("**+3.00 ")


def test_differences_to_all_bases_are_corrected_together(tmp_path):
    """Three proportional differences have one p, so Holm's factor is their number for all."""
    shift = {"ours": 0, "ours/A1": 1, "ours/latent": 2, "ours/latent-A1": 3}
    table = [r for r in copies(*shift) if r.metric == "psnr" and r.target_spp == 1]
    shifted = [
        replace(r, value=r.value + shift[r.method] * (3 + 0.1 * SCENES[r.scene])) for r in table
    ]
    write_and_read(to_dataframe(shifted), tmp_path)
    records = pd.read_csv(tmp_path / "ablation.csv")
    assert sorted(records["base"]) == ["ours", "ours", "ours/latent"]
    assert 0 < records["p_holm"].max() < 0.01
    assert records["p_holm"].tolist() == pytest.approx(list(3 * records["p_value"]), rel=1e-6)


def test_changed_settings_are_read_from_the_configs(page):
    assert cells(page, "Changed settings", "ours/latent-small")[-1] == "sampler: [4, 8] -> []"


def test_equal_configs_have_no_changed_setting(results):
    assert (
        variant_differences.config_changes(Scores(results), "ours/latent-small", "ours")
        == "no setting in the results"
    )


@pytest.mark.parametrize(
    ("variant", "main", "expected"),
    [
        ('{"a": 1}', "{}", "a: - -> 1"),
        ("{}", '{"a": 1}', "a: 1 -> -"),
        ('{"a": 1, "b": "x"}', '{"a": 2, "b": "y"}', 'a: 2 -> 1; b: "y" -> "x"'),
    ],
)
def test_settings_of_one_config_only_are_listed(variant, main, expected):
    two = [
        replace(rows(["ours"])[0], method=m, config=c) for m, c in (("f/v", variant), ("f", main))
    ]
    assert variant_differences.config_changes(Scores(to_dataframe(two)), "f/v", "f") == expected


@pytest.mark.parametrize(
    ("families", "requested", "expected"),
    [
        (["ours", "ours/a", "ntas", "ntas/a", "ntas/b"], "", "ours"),
        (["ours", "ours/a", "ntas", "ntas/a", "ntas/b"], "ntas", "ntas"),
        (["ours", "oidn", "oidn/a", "ntas", "ntas/a", "ntas/b"], "", "ntas"),
    ],
)
def test_the_family_is_the_requested_or_ours_or_that_with_most_variants(
    families, requested, expected
):
    one = [r for r in rows(["ours"]) if r.metric == "psnr"][:1]
    table = to_dataframe([r for family in families for r in rename_method(one, family)])
    assert variant_differences.choose_family([Scores(table)], requested) == expected


def test_a_family_without_variants_is_refused_with_the_names_of_others(results, tmp_path):
    with pytest.raises(
        MissingRowsError, match="main variant of 'ntas' .* families with both: ours; .*rlbench"
    ):
        ablation.write(results, tmp_path, family="ntas")


@pytest.mark.parametrize("methods", [["mean", "ntas"], ["ours/latent-small"], []])
def test_results_without_a_main_variant_and_another_are_refused(methods, tmp_path):
    table = to_dataframe(rows(methods))
    with pytest.raises(
        MissingRowsError, match="no family has scores of its main variant and of another variant"
    ):
        ablation.write(table, tmp_path)


def test_a_main_variant_on_another_device_is_no_partner():
    split = rows(["ours"]) + rows(["ours/latent-small"], device="H100")
    devices = [Scores(part) for part in split_by_device(to_dataframe(split)).values()]
    with pytest.raises(MissingRowsError, match="on one device"):
        variant_differences.choose_family(devices)


def test_budgets_that_a_variant_lacks_are_listed(tmp_path):
    table = [r for r in rows_with_configs() if r.method == "ours" or r.target_spp > 1]
    page = write_and_read(to_dataframe(table), tmp_path)[0]
    assert "- ours/latent-small at 0.5 spp: no score of it or of ours" in page
    assert len(cells(page, "PSNR minus", "ours/latent-small")) == 3  # 2, 4 and 8 spp


def test_variants_without_a_common_budget_are_listed(tmp_path):
    table = [r for r in rows_with_configs() if (r.method == "ours") == (r.target_spp > 1)]
    page = write_and_read(to_dataframe(table), tmp_path)[0]
    assert page.count("- ours/latent-small at") == 5


def test_published_variants_that_were_not_measured_are_listed(page):
    assert "- ours-B1, in rlbench ours/latent-B1\n" in page
    assert "ours-small, in rlbench" not in page


def test_rows_with_a_label_are_no_variants(tmp_path):
    table = [*rows_with_configs(), *rename_method(rows_with_configs(["ours"]), "ours@seed1")]
    assert "@" not in write_and_read(to_dataframe(table), tmp_path)[0]


def test_results_of_two_weights_are_refused(tmp_path):
    table = rows_with_configs()
    table += [replace(r, weights_hash="new", clip="other") for r in table]
    with pytest.raises(ReportError, match="2 weights_hash values"):
        ablation.write(to_dataframe(table), tmp_path)


def test_without_times_no_time_table_is_written(page, tmp_path):
    timeless = [r for r in rows_with_configs() if r.unit != "ms"]
    without = write_and_read(to_dataframe(timeless), tmp_path)[0]
    title = "### Frame time minus that of ours\n"
    assert title in page
    assert title not in without
    assert "frame time" not in without.lower()
    psnr = [cells(text, "PSNR minus", "ours/latent-small") for text in (page, without)]
    assert psnr[0] == psnr[1]


def test_a_base_without_times_has_no_time_table_beside_one_that_has(tmp_path):
    table = copies("ours", "ours/A1", "ours/latent", "ours/latent-A1")
    some = [r for r in table if r.unit != "ms" or not r.method.startswith("ours/latent")]
    page = write_and_read(to_dataframe(some), tmp_path)[0]
    assert "### Frame time minus that of ours\n" in page
    assert "### Frame time minus that of ours/latent\n" not in page
    assert "### PSNR minus that of ours/latent\n" in page


def test_the_csv_has_a_row_for_each_variant_and_budget(results, tmp_path):
    ablation.write(results, tmp_path, draws=10)
    csv = pd.read_csv(tmp_path / "ablation.csv")
    assert csv[["method", "target_spp"]].to_numpy().tolist() == [
        ["ours/latent-small", spp] for spp in (0.5, 1, 2, 4, 8)
    ]


def test_latex_and_markdown_escape_settings_and_names(tmp_path):
    table = rows_with_configs()
    table += [
        replace(r, method="ours/a_b|c", config='{"x": {"y": 1}}')
        for r in rows_with_configs(["ours"])
    ]
    page, _, tex = write_and_read(to_dataframe(table), tmp_path)
    assert "| ours/a_b\\|c |" in page
    assert r"ours/a\_b|c & " in tex
    assert r'x: - -\textgreater{} \{"y": 1\}' in tex
