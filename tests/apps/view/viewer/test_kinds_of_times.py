"""One table with times of each kind: certain, uncertain, too long, missing, claimed.

The command, the winner map, the Pareto plot and the page must say the same of each.
"""

from __future__ import annotations

import pytest

from reports.analysis.curves import curves_of, denoisers
from reports.analysis.scores import Scores
from reports.compare import compare
from reports.decide import decide
from reports.decision_text import decision_text
from reports.equal_time import write as write_equal_time
from reports.pareto import plotted_points
from reports.winners import map_winners
from rlbench.apps.view.viewer import write as write_page
from rlbench.benchmark.results import IMAGES_PREFIX
from tests.reports.formula_results import Formula, doubt, table

KINDS = {  # at 2 ms a sample and a deadline of 11 ms
    "certain": Formula(26.0, 1.0, 5.0),
    "uncertain": Formula(27.5, 1.0, 12.0),  # 14 ms at 1 spp, or 8
    "slow": Formula(28.0, 1.0, 50.0),
    "untimed": Formula(29.0, 1.0, 1.0),
    "claimed": Formula(24.0, 1.0, 1.0),
}
SAMPLE_MS, FRAME_MS = 2.0, 11.0


@pytest.fixture(scope="module")
def kinds():
    rows = doubt(table(KINDS), "uncertain")
    rows = rows[(rows["method"] != "untimed") | (rows["unit"] != "ms")]
    is_claimed = rows["method"] == "claimed"
    rows = rows[~(is_claimed & rows["metric"].isin(["sample_ms", "sampling_ms"]))].copy()
    rows.loc[is_claimed, "code_hash"] = f"{IMAGES_PREFIX}0"
    rows.loc[is_claimed, "device"] = "RTX of somebody else"
    return rows


def test_the_command_says_what_is_true_of_each_kind(kinds):
    text = decision_text(decide(kinds, SAMPLE_MS, FRAME_MS))
    assert text.startswith("certain at 3 spp")
    assert "uncertain could take its place" in text
    assert "slow" not in text  # it does not fit, whatever its interval
    assert "untimed has no time on every scene" in text
    assert "9*" in text  # 1 + 4 x 2 ms, claimed
    assert "*: images made elsewhere; budget and time are claimed" in text


def test_map_plot_and_equal_time_agree_with_the_command(kinds, tmp_path):
    scores = Scores(kinds)
    cells = map_winners(denoisers(curves_of(scores)))
    near = abs(cells.sample_ms - SAMPLE_MS).argmin(), abs(cells.deadline_ms - FRAME_MS).argmin()
    assert cells.methods[cells.winner[near]] == "certain"
    assert cells.is_uncertain[near]
    assert not cells.is_uncertain.all()
    points = plotted_points(scores)
    assert set(points.loc[points["uncertain"], "method"]) == {"uncertain"}
    assert "untimed" not in set(points["method"])
    page = write_equal_time(kinds, tmp_path)[0].read_text()
    assert "inference_ms of uncertain on city, hall" in page
    assert "untimed has no time on every scene" in page


def test_the_page_says_the_same(kinds, open_page, tmp_path):
    file = tmp_path / "page.html"
    write_page(kinds, file)
    screen = open_page(f"view=decide&sample={SAMPLE_MS}&deadline={FRAME_MS}", file=file)
    answer = screen.text(".answer")
    assert answer.startswith("certain at 3 spp")
    decision = decide(kinds, SAMPLE_MS, FRAME_MS)
    percent = f"{100 * decision.uncertainty:.0f} %"
    assert f"Times here are uncertain by {percent}: uncertain could take its place." in answer
    assert {"slow", "untimed", "uncertain"}.isdisjoint(screen.text(".ranking").split())
    assert "untimed has no time on every scene" in screen.text("main")
    screen = open_page("view=decide&sample=2&deadline=2.5", file=file)
    assert "No denoiser with a time fits. The cheapest, claimed at 1 spp" in screen.text(".answer")


def test_scores_of_images_with_a_claimed_time_need_no_device(kinds):
    comparison = compare(kinds, "certain", "claimed")
    assert comparison.budgets[0].difference.mean == pytest.approx(2.0)
