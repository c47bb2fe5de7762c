"""The report on scenes by others, from scores whose means and orders are known."""

from __future__ import annotations

import itertools

import pytest

from reports import real
from rlbench.benchmark.results import MissingRowsError, Row, to_dataframe
from tests.reports.conftest import table_rows

SCENES = ("kitchen", "classroom", "staircase")
OURS = {"a": 30.0, "b": 29.0, "c": 28.0, "d": 27.0}
THEIRS = {"a": 25.0, "b": 26.0, "c": 24.0, "d": 23.0}  # b passes a
FIRST_FRAME_LOSS = 1.0  # dB of `a`
STEADY, UNSTEADY = (0.1, -0.1, 0.0), (4.0, -4.0, 0.0)  # dB of `b`, by scene
METRICS = {"psnr": ("dB", "higher"), "blotches": ("%", "lower")}


def table(values, preset="real", budgets=(1.0,), by_scene=STEADY, metrics=("psnr", "blotches")):
    rows = []
    for metric, spp, (scene, offset), (method, value) in itertools.product(
        metrics, budgets, zip(SCENES, by_scene, strict=True), values.items()
    ):
        for clip, frame in itertools.product(("", "-000"), range(2)):
            score = value + offset * (method == "b")
            score -= FIRST_FRAME_LOSS * (frame == 0 and method == "a")
            score = score if metric == "psnr" else 10 ** (-score / 20) * 100
            rows.append(
                Row("r", method, scene + clip, scene, spp, spp, frame, metric, score,
                    *METRICS[metric], f"convention of {metric}", device="CPU", preset=preset)
            )  # fmt: skip
    return to_dataframe(rows)


def write(tmp_path, results, **options):
    return real.write(results, tmp_path, **options)[0].read_text()


def rows_of(page, title):
    return table_rows(page, title)[2:]


def test_the_page_has_scores_first_frames_and_blotches_best_first(tmp_path):
    (tmp_path / "real-kitchen.png").touch()
    page = write(tmp_path, table(THEIRS))
    assert [row[0] for row in rows_of(page, "PSNR [dB]")] == ["b", "a", "c", "d"]
    assert rows_of(page, "PSNR [dB]")[0][1] == "26.00"
    assert rows_of(page, "PSNR [dB]")[1][1].startswith("24.50 [-1")  # 25 - 1 / 2
    first = rows_of(page, real.FIRST)
    assert first[0] == ["b", "26.00"]
    assert first[1][1].startswith("24.00 [-2")
    assert [row[0] for row in rows_of(page, "Blotches on smooth surfaces [%]")][0] == "b"
    assert page.endswith("## Images\n\n![real-kitchen](real-kitchen.png)\n")


def test_the_order_is_compared_with_that_of_each_other_preset(tmp_path):
    others = {"unseen": table(OURS, "unseen"), "mini": table(THEIRS, "mini")}
    page = write(tmp_path, table(THEIRS), against=others)
    taus = dict(rows_of(page, "Agreement of the order"))
    assert taus["psnr, mini"] == "1.00 (4)"
    assert taus["psnr, unseen"] == f"{(5 - 1) / 6:.2f} (4)"  # 1 of 6 pairs is discordant
    assert set(taus) == {f"{m}, {p}" for m in METRICS for p in others}


@pytest.mark.parametrize(("by_scene", "resolved"), [(STEADY, 1), (UNSTEADY, 0)])
def test_only_swaps_that_both_presets_resolve_are_listed(tmp_path, by_scene, resolved):
    rows = {"real": table(THEIRS, by_scene=by_scene, metrics=["psnr"])}
    rows["unseen"] = table({**OURS, "a": 32.0}, "unseen", metrics=["psnr"])
    page = write(tmp_path, rows["real"], against={"unseen": rows["unseen"]})
    assert f"- psnr, unseen: 1 swaps, {resolved} of them resolved: on both presets" in page
    assert page.count("b leads a on real by +1.5 [") == resolved
    assert page.count("and trails on unseen by -2.5 [") == resolved


def test_rows_and_budgets_of_one_preset_alone_are_not_compared(tmp_path):
    other = table({name: OURS[name] for name in "acd"}, "unseen", budgets=(1.0, 4.0))
    page = write(tmp_path, table(THEIRS, budgets=(1.0, 2.0)), against={"unseen": other})
    assert dict(rows_of(page, "Agreement of the order"))["psnr, unseen"] == "1.00 (3)"


def test_results_of_another_preset_need_one_to_compare_with_and_psnr(tmp_path):
    with pytest.raises(MissingRowsError, match="preset mini"):
        write(tmp_path, table(OURS, "mini"))
    assert "Agreement" in write(tmp_path, table(OURS, "mini"), against={"b": table(THEIRS, "b")})
    with pytest.raises(MissingRowsError, match="no psnr"):
        write(tmp_path, table(THEIRS, metrics=["blotches"]))
