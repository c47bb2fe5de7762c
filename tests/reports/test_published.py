"""The published numbers agree with each other, the cost profile and the registry."""

from __future__ import annotations

import pytest

from reports.analysis.rows import family_of
from reports.published import published
from rlbench import registry
from rlbench.benchmark import cost

TABLE = {row.name: row for row in published().table}


def test_the_mean_cost_of_a_sample_is_the_mean_over_scenes():
    scenes = published().scene_ms.values()
    assert sum(scenes) / 4 == pytest.approx(published().sample_ms, abs=0.05)  # printed to 0.1 ms


def test_the_costs_equal_those_of_the_profile():
    profile = cost.profile("paper-2080ti")
    assert (profile.scene_ms, profile.default_ms) == (published().scene_ms, published().sample_ms)


@pytest.mark.parametrize(
    ("variant", "gain"),
    [("ours-A1", 0.3), ("ours-A2", 0.8), ("ours-B1", 0.7), ("ours-B2", 1.3), ("ours-C", 0.5)],
)
def test_the_table_agrees_with_the_gains_in_the_discussion(variant, gain):
    assert TABLE["ours"].psnr_db - TABLE[variant].psnr_db == pytest.approx(gain)


def test_the_table_agrees_with_the_speed_up_in_the_abstract():
    other, ours = TABLE["ReSTIR+OIDN"], TABLE["ours"]
    four, two = (4 * published().sample_ms, 2 * published().sample_ms)
    speed_up = (other.inference_ms + four) / (ours.inference_ms + two)
    assert speed_up == pytest.approx(1.6, abs=0.05)  # printed as 1.6


@pytest.mark.parametrize("row", sorted({p.row for p in published().table}))
def test_every_published_row_has_a_family_in_the_registry(row):
    assert registry.load_family(row).name == family_of(row)


def test_only_scores_that_no_table_prints_are_derived():
    derived = [point for point in published().points() if point.derived]
    assert [(p.row, p.spp, p.psnr_db) for p in derived] == [("ours/latent", 2.0, 28.2)]
