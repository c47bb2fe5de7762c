"""The campaign: every row that is compared, trained for days."""

from __future__ import annotations

import re
import tomllib

from research import rate_search
from rlbench import registry
from tests.cli.runner import CHECKOUT, rlbench

QUEUES = ("campaign", "memory", "rates")
CAMPAIGN, MEMORY, RATES = (CHECKOUT / "research" / f"{name}.toml" for name in QUEUES)


def test_the_status_lists_the_trainings_and_starts_nothing(tmp_path):
    output = rlbench("train", "--queue", CAMPAIGN, "--out", tmp_path / "r", "--status")
    assert "ours/paper-C waiting for ours/paper-A2 0 of 20000" in output
    assert re.search(r"\d+ waiting$", output)
    assert not (tmp_path / "r").exists()


def test_the_second_queue_gives_each_row_the_length_of_its_control(tmp_path, monkeypatch):
    monkeypatch.chdir(CHECKOUT)  # plugins are named relative to it
    output = rlbench("train", "--queue", MEMORY, "--out", tmp_path / "r", "--status")
    lengths = dict(re.findall(r"(\S+) waiting 0 of (\d+)", output))
    assert {n for n, frames in lengths.items() if frames == "100000"} == {
        name for name in lengths if name.startswith("sampler-")
    }
    assert set(lengths.values()) == {"100000", "600000"}


def test_the_third_queue_has_each_rate_of_each_rival(tmp_path, monkeypatch):
    monkeypatch.chdir(CHECKOUT)
    output = rlbench("train", "--queue", RATES, "--out", tmp_path / "r", "--status")
    names = re.findall(r"rates/(\S+) waiting 0 of \d+", output)
    assert sorted(names) == sorted(rate_search.FAMILY.variants)
    once, twice = (rate_search.training_task(f"nppd-x{k}", "cpu", 0).max_lr for k in (1, 2))
    assert twice == 2 * once == 2 * registry.training_task("nppd").max_lr


def test_the_campaign_anchors_the_rows_that_start_from_weights_of_others():
    rows = tomllib.loads(CAMPAIGN.read_text())["training"]
    started = {row["method"]: registry.training_task(row["method"]).pretrained for row in rows}
    anchored = {row["method"] for row in rows if "anchor" in row}
    assert anchored == {name for name, pretrained in started.items() if pretrained}
