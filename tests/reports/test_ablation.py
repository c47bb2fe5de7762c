"""The ablation tables: pairs counted by hand, and differences known from formulas."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd
import pytest

from reports import ablation
from reports.analysis.rows import split_by_device
from reports.analysis.scores import Scores
from rlbench.benchmark.results import MissingRowsError, to_dataframe
from tests.reports.conftest import SCENES, cells, renamed, rows

SETTINGS = {
    "ours": '{"bptt": 1, "sampler": [4, 8]}',
    "ours/latent-small": '{"bptt": 1, "sampler": []}',
}


def with_configs(methods=tuple(SETTINGS), **equal):
    return [replace(r, config=SETTINGS[r.method]) for r in rows(methods, **equal)]


def copies(shifts):
    """The scores of `ours` at 1 spp plus so many dB, under each of these names."""
    return [
        replace(r, method=name, value=r.value + shift)
        for name, shift in shifts.items()
        for r in rows(["ours"], metric="psnr", target_spp=1)
    ]


def page_of(table, folder, **options):
    return ablation.write(to_dataframe(table), folder, **options)[0].read_text()


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return page_of(with_configs(), tmp_path_factory.mktemp("ablation"))


def test_a_page_has_differences_settings_and_what_is_missing(page):
    assert all(c.startswith("-") for c in cells(page, "PSNR minus", "ours/latent-small")[:5])
    assert cells(page, "Frame time", "ours/latent-small")[0] == "-9.8"  # 6.7 - 16.5
    assert cells(page, "Changed settings", "ours/latent-small")[-1] == "sampler: [4, 8] -> []"
    assert "- ours-B1, in rlbench ours/latent-B1\n" in page
    assert "ours-small, in rlbench" not in page


def test_rows_with_one_label_are_compared_if_no_other_rows_exist(page, tmp_path):
    brief = [replace(r, method=f"{r.method}@brief") for r in with_configs()]
    labelled = page_of([*brief, *rows(("mean",))], tmp_path)
    assert "rows @brief" in labelled.splitlines()[0]
    assert labelled.splitlines()[1:] == page.splitlines()[1:]
    mixed = [*with_configs(), *renamed(with_configs(["ours"]), ours="ours@seed1")]
    assert "@" not in page_of(mixed, tmp_path)


def test_scores_without_a_partner_and_budgets_that_a_variant_lacks_are_listed(tmp_path):
    table = [r for r in with_configs() if r.method == "ours" or r.target_spp > 0.5]
    small = with_configs(["ours/latent-small"], metric="psnr", target_spp=1)
    alone = [replace(r, seed=1) for r in small]
    page = page_of([*table, *alone], tmp_path)
    assert "- ours/latent-small at 1 spp: 32 scores without a partner, 32 pairs" in page
    assert "- ours/latent-small at 0.5 spp: it or ours has no score" in page


def test_a_variant_of_a_part_is_compared_with_the_part_where_that_was_scored(tmp_path):
    """The part is 2 dB better than the main variant, its variant 3 dB better."""
    scores = copies({"ours": 0.0, "ours/latent": 2.0, "ours/latent-A1": 3.0})
    page = page_of(scores, tmp_path)
    assert "frame time" not in page.lower()  # without times
    assert cells(page, "PSNR minus that of ours\n", "ours/latent")[0].startswith("+2.00 ")
    row = cells(page, "PSNR minus that of ours/latent", "ours/latent-A1")
    assert row[0].startswith("+1.00 ")
    assert row[-1] == "-0.3"  # 28.4 - 28.7 in print
    page = page_of([r for r in scores if r.method != "ours/latent"], tmp_path)
    assert cells(page, "PSNR minus that of ours\n", "ours/latent-A1")[0].startswith("+3.00 ")


def test_differences_to_all_bases_are_corrected_together(tmp_path):
    """Three proportional differences have one p, so Holm's factor is their number for all."""
    factors = {"ours": 0, "ours/A1": 1, "ours/latent": 2, "ours/latent-A1": 3}
    table = [
        replace(r, value=r.value + factors[r.method] * (3 + 0.1 * SCENES[r.scene]))
        for r in copies(dict.fromkeys(factors, 0.0))
    ]
    page_of(table, tmp_path)
    records = pd.read_csv(tmp_path / "ablation.csv")
    assert sorted(records["base"]) == ["ours", "ours", "ours/latent"]
    assert records["p_holm"].tolist() == pytest.approx(list(3 * records["p_value"]), rel=1e-6)


@pytest.mark.parametrize(
    ("variant", "main", "expected"),
    [
        ({"a": 1, "b": "x"}, {"b": "y", "c": 2}, 'a: - -> 1; b: "y" -> "x"; c: 2 -> -'),
        ({"a": 1}, {"a": 1}, "no setting in the results"),
    ],
)
def test_settings_that_differ_are_listed(variant, main, expected):
    assert ablation.config_changes(variant, main) == expected


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
    one = rows(["ours"], metric="psnr")[0]
    table = to_dataframe([replace(one, method=family) for family in families])
    assert ablation.choose_family([Scores(table)], requested) == expected


def test_a_family_without_variants_on_one_device_is_refused():
    with pytest.raises(MissingRowsError, match="families with both: ours"):
        ablation.choose_family([Scores(to_dataframe(with_configs()))], "ntas")
    split = rows(["ours"]) + rows(["ours/latent-small"], device="H100")
    devices = [Scores(part) for part in split_by_device(to_dataframe(split)).values()]
    with pytest.raises(MissingRowsError, match="on one device"):
        ablation.choose_family(devices)
