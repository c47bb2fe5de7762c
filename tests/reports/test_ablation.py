"""The ablation table: pairs that a hand can count, and differences known from formulas."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd
import pytest
from conftest import rows

from reports import ablation
from reports.analysis import variant_differences
from reports.analysis.aggregate import ReportError
from rlbench.benchmark.results import MissingRowsError, to_dataframe

SETTINGS = {"ours": '{"bptt": 1, "sampler": [4, 8]}', "ours/small": '{"bptt": 1, "sampler": []}'}


def configured(methods=("ours", "ours/small")):
    return [replace(r, config=SETTINGS[r.method]) for r in rows(methods)]


def renamed(made, method):
    return [replace(r, method=method) for r in made]


def written(table, folder, **asked):
    return [file.read_text() for file in ablation.write(table, folder, draws=200, **asked)]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return written(to_dataframe(configured()), tmp_path_factory.mktemp("ablation"))[0]


@pytest.fixture(scope="module")
def found(results):
    return variant_differences.differences(results, "ours", draws=200).set_index(
        ["method", "target_spp"]
    )


def line(page, title, start):
    section = page[page.index(f"### {title}") :]
    found = next(x for x in section.splitlines() if x.startswith(f"| {start} "))
    return [cell.strip() for cell in found.split("|")[2:-1]]


def test_trainings_of_one_name_are_compared_by_it(page, tmp_path):
    brief = [replace(r, method=f"{r.method}@brief") for r in configured()]
    (named, *_) = written(to_dataframe([*brief, *rows(("mean",))]), tmp_path)
    assert "rows @brief" in named.splitlines()[0]
    assert named.splitlines()[1:] == page.splitlines()[1:]


def test_markdown_csv_and_latex_are_written(results, tmp_path):
    files = ablation.write(results, tmp_path, draws=10)
    assert [file.name for file in files] == ["ablation.md", "ablation.csv", "ablation.tex"]


@pytest.mark.parametrize("spp", [0.5, 1, 2, 4, 8])
def test_the_difference_is_that_of_the_formulas(found, spp):
    wanted = 29.2 - 29.9 + (1.1 - 1.15) * math.log2(spp)
    assert found.loc[("ours/small", spp), "difference"] == pytest.approx(wanted)


def test_every_clip_and_frame_is_a_pair(found):
    row = found.loc[("ours/small", 4)]
    assert (row["pairs"], row["alone"], row["units"]) == (4 * 2 * 4, 0, 4)


def test_the_interval_of_one_scene_is_that_of_its_clips():
    city = to_dataframe([r for r in configured() if r.scene == "city"])
    row = variant_differences.differences(city, "ours", draws=500).set_index("target_spp").loc[1.0]
    half = 12.7062 * 0.06  # Student's t of its two clips, which have -0.76 and -0.64
    assert (row["low"], row["high"]) == pytest.approx((-0.7 - half, -0.7 + half), rel=1e-4)


def test_the_time_is_that_of_plan_and_denoise_as_samples_cost_the_same(found):
    assert found.loc[("ours/small", 2), "frame_ms"] == pytest.approx(2.2 + 4.5 - 5.5 - 11.0)


def test_a_seed_that_only_one_of_them_has_is_left_out_and_told(tmp_path):
    made = configured()
    wild = [
        replace(r, seed=1, value=r.value + 50)
        for r in made
        if r.method == "ours/small" and r.metric == "psnr"
    ]
    table = to_dataframe([*made, *wild])
    row = variant_differences.differences(table, "ours", draws=10).set_index("target_spp").loc[1.0]
    assert row["difference"] == pytest.approx(-0.7)
    told = "- ours/small at 1 spp: 32 scores without a partner, 32 pairs"
    assert told in written(table, tmp_path)[0]


def test_seeds_are_paired_with_their_own():
    """Default: 0 and +10 dB by seed; variant: 1 more. By seed each pair differs by one."""
    base = [r for r in configured(["ours"]) if r.metric == "psnr" and r.target_spp == 1]
    seeded = [replace(r, seed=s, value=10.0 * s) for r in base for s in (0, 1)]
    more = [replace(r, method="ours/small", value=r.value + 1) for r in seeded]
    found = variant_differences.differences(to_dataframe([*seeded, *more]), "ours", draws=100).iloc[
        0
    ]
    assert (found["difference"], found["low"], found["high"]) == (1, 1, 1)
    assert found["pairs"] == 64


def test_bold_is_what_excludes_zero(page):
    assert all(cell.startswith("**-") for cell in line(page, "PSNR less", "ours/small")[:5])


def test_a_difference_that_holds_zero_is_not_bold(tmp_path):
    base = [r for r in configured(["ours"]) if r.metric == "psnr"]
    ends = {clip: 1 - 2 * (i % 2) for i, clip in enumerate(sorted({r.clip for r in base}))}
    swung = [replace(r, method="ours/A9", value=r.value + ends[r.clip]) for r in base]
    page = written(to_dataframe([*base, *swung]), tmp_path)[0]
    assert "**" not in page


def test_the_paper_s_difference_stands_beside(page):
    assert line(page, "PSNR less", "ours/small")[-1] == "-1.4"  # 27.3 - 28.7


def test_what_a_variant_changes_is_read_from_its_settings(page):
    assert line(page, "What each changes", "ours/small")[-1] == "sampler: [4, 8] -> []"


def test_equal_settings_are_said_to_be_equal(results):
    assert variant_differences.changes(results, "ours/small", "ours") == "none that they wrote down"


@pytest.mark.parametrize(
    ("one", "other", "told"),
    [
        ('{"a": 1}', "{}", "a: - -> 1"),
        ("{}", '{"a": 1}', "a: 1 -> -"),
        ('{"a": 1, "b": "x"}', '{"a": 2, "b": "y"}', 'a: 2 -> 1; b: "y" -> "x"'),
    ],
)
def test_settings_that_only_one_has_are_told(one, other, told):
    two = [replace(rows(["ours"])[0], method=m, config=c) for m, c in (("f/v", one), ("f", other))]
    assert variant_differences.changes(to_dataframe(two), "f/v", "f") == told


@pytest.mark.parametrize(
    ("families", "asked", "chosen"),
    [
        (["ours", "ours/a", "ntas", "ntas/a", "ntas/b"], "", "ours"),
        (["ours", "ours/a", "ntas", "ntas/a", "ntas/b"], "ntas", "ntas"),
        (["ours", "oidn", "oidn/a", "ntas", "ntas/a", "ntas/b"], "", "ntas"),
    ],
)
def test_the_family_is_the_one_asked_for_or_ours_or_that_of_most_variants(families, asked, chosen):
    one = [r for r in rows(["ours"]) if r.metric == "psnr"][:1]
    table = to_dataframe([r for family in families for r in renamed(one, family)])
    assert variant_differences.chosen(table, asked) == chosen


def test_a_family_without_variants_is_refused_with_those_that_have_some(results, tmp_path):
    with pytest.raises(
        MissingRowsError, match="'ntas' has no default and variant .* do: ours; rlbench"
    ):
        ablation.write(results, tmp_path, family="ntas")


@pytest.mark.parametrize("methods", [["mean", "ntas"], ["ours/small"], []])
def test_a_table_without_variants_beside_their_default_is_refused(methods, tmp_path):
    table = to_dataframe(rows(methods))
    with pytest.raises(MissingRowsError, match="no family has its default and a variant"):
        ablation.write(table, tmp_path)


def test_a_default_of_another_device_is_no_partner():
    split = rows(["ours"]) + rows(["ours/small"], device="H100")
    with pytest.raises(MissingRowsError, match="on one device"):
        variant_differences.chosen(to_dataframe(split))


def test_budgets_that_one_lacks_are_told(tmp_path):
    made = [r for r in configured() if r.method == "ours" or r.target_spp > 1]
    page = written(to_dataframe(made), tmp_path)[0]
    assert "- ours/small at 0.5 spp: not scored, or ours is not" in page
    assert len(line(page, "PSNR less", "ours/small")) == 3 + 1  # 2, 4 and 8 spp, and the paper's


def test_no_budget_in_common_is_told(tmp_path):
    made = [r for r in configured() if (r.method == "ours") == (r.target_spp > 1)]
    page = written(to_dataframe(made), tmp_path)[0]
    assert page.count("- ours/small at") == 5


def test_variants_of_the_paper_that_are_not_here_are_told(page):
    assert "- ours-B1, here ours/B1\n" in page
    assert "ours-small, here" not in page


def test_rows_of_named_weights_are_no_variants(tmp_path):
    made = [*configured(), *renamed(configured(["ours"]), "ours@seed1")]
    assert "@" not in written(to_dataframe(made), tmp_path)[0]


def test_results_of_two_weights_are_not_mixed(tmp_path):
    made = configured()
    made += [replace(r, weights_hash="new", clip="other") for r in made]
    with pytest.raises(ReportError, match="2 weights_hash values"):
        ablation.write(to_dataframe(made), tmp_path)


def test_without_times_the_scores_are_still_there(tmp_path):
    page = written(to_dataframe([r for r in configured() if r.unit != "ms"]), tmp_path)[0]
    assert line(page, "Frame time", "ours/small") == ["-"] * 5
    assert "cost of a sample: not measured" in page


def test_the_csv_has_a_row_for_each_variant_and_budget(results, tmp_path):
    ablation.write(results, tmp_path, draws=10)
    found = pd.read_csv(tmp_path / "ablation.csv")
    assert found[["method", "target_spp"]].to_numpy().tolist() == [
        ["ours/small", spp] for spp in (0.5, 1, 2, 4, 8)
    ]


def test_latex_and_markdown_escape_settings_and_names(tmp_path):
    made = configured()
    made += [
        replace(r, method="ours/a_b|c", config='{"x": {"y": 1}}') for r in configured(["ours"])
    ]
    page, _, tex = written(to_dataframe(made), tmp_path)
    assert "| ours/a_b\\|c |" in page
    assert r"ours/a\_b|c & " in tex
    assert r'x: - -> \{"y": 1\}' in tex
