"""The page of metrics says what the catalogue says."""

from __future__ import annotations

from pathlib import Path

import pytest

from metrics.conventions import CONVENTIONS
from rlbench import registry

PAGE = (Path(__file__).parents[2] / "docs/reference/metrics.md").read_text().splitlines()


@pytest.mark.parametrize("name", registry.list_plugins("metrics"))
def test_the_page_has_the_row_of_every_metric(name):
    metric = registry.load_plugin("metrics", name)
    convention = metric.convention.replace("|", "&#124;")
    signed = "-" if "counts" in metric.needs else "zero"  # a metric of effort judges no image
    unit, better = metric.unit or "-", metric.direction or signed
    assert f"| `{metric.name}` | {unit} | {better} | {convention} | {metric.source} |" in PAGE


@pytest.mark.parametrize("convention", CONVENTIONS.values(), ids=lambda c: c.name)
def test_the_page_has_the_row_of_every_convention(convention):
    assert f"| `{convention.name}` | {convention.sentence} |" in PAGE
