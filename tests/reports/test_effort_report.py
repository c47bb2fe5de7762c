"""Report effort: histograms add up, and a row without one is no row of zeros."""

from __future__ import annotations

import pandas as pd
import pytest

from reports.effort import count_shares, measure_effort, write
from rlbench.benchmark.results import COUNT_PREFIX, WHOLE_CLIP, MissingRowsError, Row, to_dataframe


def cell(method, scene, shares, **metrics):
    """The rows of a cell: its histogram in percent, and metrics of frames 0 and 1."""

    def row(frame, metric, value):
        return Row("r", method, scene, scene, 1.0, 1.0, frame, metric, value)

    counted = [row(WHOLE_CLIP, f"{COUNT_PREFIX}{n}", share) for n, share in enumerate(shares)]
    given = {"effort_noise": 0.5, "effort_error": 0.1, "at_cap": 2.0, **metrics}
    scored = [row(frame, name, value) for frame in (0, 1) for name, value in given.items()]
    return [*counted, *scored]


ADAPTIVE = [
    *cell("a", "city", [30.0, 50.0, 10.0, 10.0], at_cap=4.0),
    *cell("a", "hall", [10.0, 80.0, 10.0, 0.0], at_cap=0.0),
]
CAPPED = [*cell("b", "city", [25.0, 50.0, 25.0]), *cell("b", "hall", [25.0, 50.0, 25.0])]
UNIFORM = [*cell("mean", "city", [0.0, 100.0]), *cell("mean", "hall", [0.0, 100.0])]
OLDER = [*cell("old", "city", []), *cell("old", "hall", [])]


def test_shares_are_means_over_scenes_and_a_smaller_cap_has_none_above_it():
    shares = count_shares(to_dataframe([*ADAPTIVE, *CAPPED])).set_index("method")
    assert shares.loc["a", ["0", "1", "2", "3"]].tolist() == [20, 65, 10, 5]
    assert shares.loc["b", ["0", "1", "2", "3"]].tolist() == [25, 50, 25, 0]


def test_rows_with_equal_counts_and_older_rows_are_left_out():
    shares = count_shares(to_dataframe([*ADAPTIVE, *UNIFORM, *OLDER]))
    assert shares["method"].tolist() == ["a"]


def test_the_share_at_the_cap_is_shown_scene_by_scene():
    (effort,) = measure_effort(to_dataframe(ADAPTIVE)).to_dict("records")
    assert (effort["at_cap"], effort["at_cap city"], effort["at_cap hall"]) == (2, 4, 0)


def test_the_page_has_a_row_for_each_adaptive_method(tmp_path):
    page, numbers, _ = write(to_dataframe([*ADAPTIVE, *UNIFORM]), tmp_path)
    assert "| a | 1 | 20.0 | 65.0 | 10.0 | 5.0 |" in page.read_text()
    assert "| a | 1 | 0.50 | 0.10 | 2.00 | 4.00 | 0.00 |" in page.read_text()
    assert "| mean |" not in page.read_text()
    assert pd.read_csv(numbers)["at_cap city"].tolist() == [4]


@pytest.mark.parametrize("rows", [UNIFORM, OLDER])
def test_results_without_adaptive_rows_say_what_to_run(rows, tmp_path):
    with pytest.raises(MissingRowsError, match="Score an adaptive method with rlbench run"):
        write(to_dataframe(rows), tmp_path)
