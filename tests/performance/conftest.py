"""The table of a page of docs, printed by the benches whose figures it has."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import pytest

Cells = dict[str, dict[str, str]]  # by row and column


@pytest.fixture(scope="module")
def table(request: pytest.FixtureRequest) -> Iterator[Cells]:
    """Cells to fill, printed at the end; the first of the module's COLUMNS is that of rows."""
    cells: Cells = defaultdict(dict)
    yield cells
    name, *columns = request.module.COLUMNS
    lines = [f"| {name} | {' | '.join(columns)} |", f"|---|{'---:|' * len(columns)}"]
    for row, own in cells.items():
        lines.append(f"| {row} | {' | '.join(own.get(column, '') for column in columns)} |")
    with request.config.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled():
        print("", *lines, sep="\n")  # noqa: T201
