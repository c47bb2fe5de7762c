"""The page of metrics says what the catalogue says."""

from __future__ import annotations

from pathlib import Path

from metrics.conventions import CONVENTIONS
from rlbench import registry

PAGE = (Path(__file__).parents[2] / "docs/reference/metrics.md").read_text().splitlines()


def test_the_page_has_the_row_of_every_metric():
    for metric in (registry.load_plugin("metrics", n) for n in registry.list_plugins("metrics")):
        convention = metric.convention.replace("|", "&#124;")
        signed = "-" if "counts" in metric.needs else "zero"  # a metric of effort judges no image
        unit, better = metric.unit or "-", metric.direction or signed
        assert f"| `{metric.name}` | {unit} | {better} | {convention} | {metric.source} |" in PAGE


def test_the_page_has_the_row_of_every_convention():
    rows = {f"| `{each.name}` | {each.sentence} |" for each in CONVENTIONS.values()}
    assert rows <= set(PAGE)
