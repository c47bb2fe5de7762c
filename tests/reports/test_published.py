"""The paper's numbers: consistent with each other, with the cost profile and with the registry."""

from __future__ import annotations

import pytest

from reports.analysis import method_names
from reports.published import published
from rlbench import registry
from rlbench.benchmark import cost

TABLE = {stated.name: stated for stated in published().table}


def test_the_mean_cost_of_a_sample_is_that_of_its_scenes():
    scenes = published().scene_ms.values()
    assert sum(scenes) / 4 == pytest.approx(published().sample_ms, abs=0.05)  # printed to 0.1 ms


def test_the_costs_are_those_of_the_profile():
    profile = cost.profile("paper-2080ti")
    assert (profile.scene_ms, profile.default_ms) == (published().scene_ms, published().sample_ms)


@pytest.mark.parametrize(
    ("variant", "gain"),
    [("ours-A1", 0.3), ("ours-A2", 0.8), ("ours-B1", 0.7), ("ours-B2", 1.3), ("ours-C", 0.5)],
)
def test_the_table_has_the_gains_that_the_discussion_tells(variant, gain):
    assert TABLE["ours"].psnr_db - TABLE[variant].psnr_db == pytest.approx(gain)


def test_the_time_saved_is_the_factor_that_the_abstract_tells():
    there, here = TABLE["ReSTIR+OIDN"], TABLE["ours"]
    four, two = (4 * published().sample_ms, 2 * published().sample_ms)
    saved = (there.inference_ms + four) / (here.inference_ms + two)
    assert saved == pytest.approx(1.6, abs=0.05)  # told as 1.6


@pytest.mark.parametrize("row", sorted({s.row for s in published().table}))
def test_a_row_of_the_paper_is_of_a_family_that_is_here(row):
    assert registry.load_family(row).name == method_names.family(row)


def test_only_what_no_table_prints_is_called_derived():
    derived = [point for point in published().points() if point.derived]
    assert [(p.row, p.spp, p.psnr_db) for p in derived] == [("ours", 2.0, 28.2)]


@pytest.mark.parametrize(
    ("method", "parts"),
    [
        ("ours", ("ours", "ours", "", "")),
        ("ours/A2", ("ours", "ours/A2", "", "")),
        ("ours/A2@seed12", ("ours", "ours/A2", "seed12", "ours/A2@seed")),
        ("restir+oidn@long", ("restir+oidn", "restir+oidn", "long", "restir+oidn@long")),
    ],
)
def test_a_name_says_family_row_weights_and_series(method, parts):
    found = (
        method_names.family(method),
        method_names.row(method),
        method_names.weights(method),
        method_names.training_series(method),
    )
    assert found == parts
