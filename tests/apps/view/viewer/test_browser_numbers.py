"""Decide and Table in a real browser: against `rlbench decide`, and against the rows."""

from __future__ import annotations

import csv
import io
import math

import pytest

from reports.analysis.curves import measured_sample_ms
from reports.analysis.rows import split_by_device
from reports.analysis.scores import Scores
from reports.decide import decide
from reports.pareto import OVERALL, plotted_points
from tests.apps.view.viewer.conftest import METHODS

RANK = """async ([sample, deadline]) => {
  const { rank } = await import("viewer/decide.js");
  const { data } = await import("viewer/data.js");
  const { sign, unit, scopes } = data.devices[0].decide.find((each) => each.metric === "psnr");
  const options = { sign, unit, student: data.student, tie: data.tie_db };
  return rank(scopes[0].curves, sample, deadline, options).map((each) => ({
    method: each.method, spp: each.spp, mean: each.mean, frame_ms: each.frameMs,
    gap: [each.gap.mean, each.gap.low, each.gap.high], verdict: each.verdict,
  }));
}"""


def times(report):
    """Frame times of the run without samples, ms, ascending."""
    rows = report.rows[report.rows["metric"] == "inference_ms"]
    return sorted(rows.groupby(["method", "target_spp"])["value"].mean())


def test_the_page_decides_as_the_command_does(open_page, report):
    screen = open_page()
    longest = times(report)[-1]
    for sample, times_longest in [(0.3, 2), (longest, 3.2), (longest, 2.5)]:
        deadline = longest * times_longest
        expected = decide(report.rows, sample, deadline).candidates
        found = screen.page.evaluate(RANK, [sample, deadline])
        assert [each["method"] for each in found] == [each.method for each in expected]
        for one, other in zip(found, expected, strict=True):
            assert one["spp"] == pytest.approx(other.spp)
            assert one["mean"] == pytest.approx(other.value.mean)
            assert one["frame_ms"] == pytest.approx(other.frame_ms)
            assert one["verdict"] == other.verdict
            if not math.isnan(other.difference.low):  # that of the winner
                gap = (other.difference.mean, other.difference.low, other.difference.high)
                assert one["gap"] == pytest.approx(gap)


def test_the_heading_names_device_and_size(open_page, report):
    ((device, rows),) = split_by_device(report.rows).items()
    (size,) = set(rows["size"]) - {""}
    assert f"{device}, {size}" in open_page().page.inner_text(".toolbar")


def test_plot_and_table_have_the_frame_time_of_the_command(open_page, report):
    """At the cost of a sample in the results, and at a measured budget, with a G-buffer."""
    scores = Scores(report.rows)
    table = scores.overall.set_index(["method", "target_spp"])["frame_ms"]
    best = decide(report.rows, measured_sample_ms(scores), 2 * table.max()).candidates[0]
    assert best.spp in (1, 2)
    assert table[best.method, best.spp] == pytest.approx(best.frame_ms)
    plotted = plotted_points(scores).set_index(["scene", "method", "target_spp"])["frame_ms"]
    assert plotted[OVERALL, best.method, best.spp] == pytest.approx(best.frame_ms)
    page = open_page(f"view=table&tspp={best.spp:g}").page
    cell = page.locator(f"tr[data-row='{best.method}'] td:nth-child(7)").inner_text()
    assert float(cell) == pytest.approx(best.frame_ms, rel=0.01)


def test_sliders_change_the_winner_and_the_deadline_line(open_page, report):
    longest = times(report)[-1]
    screen = open_page(f"view=decide&sample=0.1&deadline={longest * 3:.4g}")
    best = screen.page.get_attribute("[data-winner]", "data-winner")
    assert best == decide(report.rows, 0.1, float(f"{longest * 3:.4g}")).candidates[0].method
    before = screen.page.get_attribute("line.deadline", "x1")
    screen.page.get_by_label("deadline").press("Home")
    assert screen.state["deadline"] == 0.1
    assert screen.page.get_attribute("line.deadline", "x1") != before
    screen.page.get_by_label("cost of a sample").press("End")
    assert screen.state["sample"] == 1000
    assert "No denoiser with a time fits. The cheapest, " in screen.text(".answer")
    screen.page.click("text=measured cost")
    assert screen.state["sample"] == pytest.approx(2.0)


def test_a_scene_and_a_score_can_be_chosen(open_page):
    screen = open_page("view=decide&sample=0.1&deadline=1000")
    screen.page.get_by_label("scene").select_option("beta")
    assert screen.state["scope"] == "beta"
    assert "Student's t over clips" in screen.text("main")
    screen.page.get_by_label("score", exact=True).select_option("relmse")
    assert "relMSE" in screen.text(".ranking thead")


def test_uncertain_times_are_ranked_and_their_points_are_hollow_with_a_bar(open_page):
    screen = open_page("view=decide&sample=0.1&deadline=1000")
    assert {"eaw", "svgf"} <= set(screen.text(".ranking").split())
    assert "inference_ms of eaw on" in screen.text("main")
    assert screen.page.locator("[data-curve='eaw'] line.doubt").count() == 2
    assert screen.page.locator("[data-curve='svgf'] line.doubt").count() == 0
    hollow = screen.page.locator("[data-curve='eaw'] circle[fill='var(--paper)']")
    assert hollow.count() == 2
    screen.press("b")
    cells = screen.page.locator("tr[data-row='eaw'] td:nth-child(6)").all_inner_texts()
    assert all(cell.endswith("±100 %") for cell in cells)


def methods_of(screen):
    return screen.page.eval_on_selector_all("tbody tr", "all => all.map((row) => row.dataset.row)")


def psnr_means(report, spp):
    rows = report.rows[(report.rows["metric"] == "psnr") & (report.rows["target_spp"] == spp)]
    return rows.groupby("method")["value"].mean().sort_values()


def test_a_header_sorts_and_again_the_other_way(open_page, report):
    screen = open_page("view=table&tspp=1")
    ascending = list(psnr_means(report, 1).index)
    assert methods_of(screen) == ascending[::-1]
    screen.page.click("[data-sort=mean]")
    assert methods_of(screen) == ascending
    assert screen.page.locator("th[aria-sort=ascending]").count() == 1
    screen.page.click("[data-sort=method]")
    assert methods_of(screen) == sorted(METHODS)


def test_traits_names_and_budgets_filter(open_page):
    screen = open_page("view=table")
    assert len(methods_of(screen)) == 2 * len(METHODS)
    screen.page.get_by_label("budget").select_option("2")
    assert sorted(methods_of(screen)) == sorted(METHODS)
    screen.page.click("[data-filter=temporal]")
    assert methods_of(screen) == ["svgf"]
    screen.page.click("[data-filter=temporal]")
    screen.page.click("[data-filter='without normal']")
    assert methods_of(screen) == ["mean"]
    screen.page.click("[data-filter='without normal']")
    screen.page.get_by_label("name contains").fill("ea")
    assert sorted(methods_of(screen)) == ["eaw", "mean"]


@pytest.mark.parametrize("copied", ["markdown", "latex", "csv"])
def test_the_table_is_copied_as_text(open_page, report, copied):
    screen = open_page("view=table&tspp=1")
    screen.page.click(f"[data-copy={copied}]")
    screen.page.wait_for_selector("textarea:not([hidden])")
    text = screen.page.input_value("textarea")
    score = f"{psnr_means(report, 1)['mean']:.2f}"
    if copied == "csv":
        records = list(csv.DictReader(io.StringIO(text)))
        assert {each["method"] for each in records} == set(METHODS)
        assert next(each for each in records if each["method"] == "mean")["PSNR [dB]"] == score
    else:
        start = {"markdown": "| mean | 1 | ", "latex": "mean & 1 & "}[copied]
        assert f"\n{start}{score} " in text
    if copied == "latex":
        assert text.count(r"\\") == 1 + len(METHODS)
        assert r"\begin{tabular}{lrrrrrr}" in text
    screen.page.wait_for_function("document.querySelector('[role=status].hint').textContent")
    assert screen.page.evaluate("navigator.clipboard.readText()") == text


def test_a_link_shows_the_same_again(open_page):
    screen = open_page("view=table")
    screen.page.get_by_label("name contains").fill("ea")
    screen.page.click("[data-sort=method]")
    screen.page.click("[data-copy=link]")
    link = screen.page.input_value("textarea")
    again = open_page(link.partition("#")[2])
    assert methods_of(again) == methods_of(screen)
    assert again.state == screen.state


def test_provenance_appears_on_focus_and_on_hover(open_page, report):
    screen = open_page("view=table&tspp=1")
    shown = screen.page.locator("tr[data-row=eaw] .provenance")
    assert not shown.is_visible()
    screen.page.hover("tr[data-row=eaw] .named")
    assert shown.is_visible()
    screen.page.mouse.move(0, 0)
    screen.page.focus("tr[data-row=eaw] .named")
    code = set(report.rows.loc[report.rows["method"] == "eaw", "code_hash"]).pop()
    assert code in shown.inner_text()
