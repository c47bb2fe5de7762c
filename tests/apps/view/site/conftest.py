"""The pages of the shipped baseline and of made-up results, and facts of the installed methods."""

from __future__ import annotations

import pytest

from rlbench.apps.render.scene_facts import SceneFacts, TakeFacts
from rlbench.apps.view.site import build_pages, preset_scores
from rlbench.benchmark.listing import method_facts
from rlbench.benchmark.regression.baseline import find_baseline, load_baseline, to_table


@pytest.fixture(scope="session")
def baseline():
    return load_baseline(find_baseline("mini"))


@pytest.fixture(scope="session")
def scores(baseline):
    errors = {entry.key: entry.stderr_db for entry in baseline.entries}
    return preset_scores(to_table(baseline), "From the baseline.", errors)


@pytest.fixture(scope="session")
def methods():
    return method_facts()


@pytest.fixture(scope="session")
def city():
    takes = (TakeFacts("city", False, (), ()), TakeFacts("city-cut", False, (10,), (15,)))
    text = ("City: house fronts.", "It tests foliage.")
    return SceneFacts("city", "City: a square", text, ("sun and sky",), takes, 9, ("mini",), "MIT")


@pytest.fixture(scope="session")
def site(scores, methods, city):
    """Pages by path, and the navigation."""
    pictures, images = {"city": "scenes/city.png"}, {"results/images.png": ("ours", "mean")}
    return build_pages(scores, methods, [city], pictures, images)
