"""Speed: what is counted agrees with closed forms, and the table has every row."""

from __future__ import annotations

import math
from pathlib import Path

import pandas as pd
import pytest
import torch
from typer.testing import CliRunner

from rlbench import registry
from rlbench.benchmark.cost_profile import read_profile, write_profile
from rlbench.benchmark.speed import (
    COLUMNS,
    Configuration,
    TrafficCounter,
    count_work,
    measure_speed,
    profile_times,
    speed_page,
)
from rlbench.cli.app import app
from rlbench.errors import RlbenchError
from rlbench.ops.unet_widths import BASE_WIDTHS
from rlbench.weights import read_card

CPU = torch.device("cpu")

SIZES = [(48, 64), (32, 32)]


def unet_multiply_adds(inputs: int, outputs: int) -> float:
    """Per pixel, of 3 x 3 convolutions; 2 x 2 products where an upsampled level is read."""
    e1, e2, e3, e4, e5, (d4a, d4b), (d3a, d3b), (d2a, d2b), (d1a, d1b) = BASE_WIDTHS
    full = inputs * e1 + e1 * e1 + inputs * d1a + d1a * d1b + d1b * outputs
    half = e1 * e2 + e1 * d2a + d2a * d2b
    quarter = e2 * e3 + e2 * d3a + d3a * d3b
    eighth = e3 * e4 + e3 * d4a + d4a * d4b
    bottom = e4 * e5 + e5 * e5
    upsampled = d2b * d1a + d3b * d2a / 4 + d4b * d3a / 16 + e5 * d4a / 64
    return 9 * (full + half / 4 + quarter / 16 + eighth / 64 + bottom / 256) + 4 * upsampled


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    configurations = [Configuration(name) for name in ("mean", "ours", "oidn")]
    configurations.insert(2, Configuration("ours", "openvino"))
    return measure_speed(configurations, SIZES, CPU, repeats=1)


def test_multiply_adds_are_those_of_the_layers():
    """Within a thousandth: the exposure is a small product too."""
    method = registry.load_method("oidn", CPU, "random")
    assert count_work(method, CPU).multiply_adds == pytest.approx(
        unet_multiply_adds(9, 3), rel=1e-3
    )


def test_parameters_are_those_on_the_model_card(table):
    ours = table[table.method == "ours"].iloc[0]
    card = read_card(Path("methods/ours/cards/ours.safetensors"))
    assert ours.parameters * 1e3 == pytest.approx(card.parameters)
    assert set(table[table.method == "mean"].parameters) == {0}


def test_a_row_that_needs_two_samples_is_timed_with_two():
    line = measure_speed([Configuration("cross")], [(32, 32)], CPU, repeats=1).iloc[0]
    assert line.denoise_ms > 0
    assert line.state_bytes > 13 * 4  # image, both pilots, depth, normal; and the learner


def test_the_table_has_each_configuration_at_each_size_and_its_parts_add_up(table):
    assert list(table.columns) == list(COLUMNS)
    names = ["mean", "ours", "ours@openvino", "oidn"]
    assert list(table.method) == names * 2
    assert list(zip(table.height, table.width, strict=True)) == [s for s in SIZES for _ in names]
    parts = table.plan_ms + table.allocate_ms + table.denoise_ms
    pd.testing.assert_series_equal(parts, table.inference_ms, check_names=False)
    assert (table.inference_ms > 0).all()


def test_state_is_counted_per_pixel(table):
    """Of ours: radiance 3 + 1 + 1, image 3 and G-buffer 7 in single precision, and one mean spp."""
    first = table[table.height == 48].set_index("method").state_bytes
    assert first["mean"] == first["oidn"] == 0
    assert first["ours"] == pytest.approx(15 * 4 + 4 / (48 * 64))


def test_memory_of_a_frame_is_that_of_its_largest_layers(table):
    """OIDN's first two layers are alive at once, with 32 channels each."""
    memory = table[(table.method == "oidn") & (table.height == 48)].memory_mb.item()
    assert 2 * 32 * 4 * 48 * 64 / 2**20 < memory < 20 * 32 * 4 * 48 * 64 / 2**20
    assert math.isnan(table[table.method == "ours@openvino"].memory_mb.iloc[0])


@pytest.mark.parametrize(
    ("share", "work", "methods"),
    [
        ("peak_share", "multiply_adds", ["ours", "oidn"]),
        ("bandwidth_share", "traffic_bytes", ["mean", "oidn"]),
    ],
)
def test_a_share_is_work_over_time(table, share, work, methods):
    rows = table[table.method.isin(methods)]
    ratios = rows[share] / (rows[work] * rows.height * rows.width / rows.inference_ms)
    assert ratios.max() == pytest.approx(ratios.min())
    assert (rows[share] > 0).all()


def test_a_share_of_the_peak_is_below_one(table):
    oidn = table[table.method == "oidn"].iloc[0]
    at_most_ms = oidn.inference_ms / oidn.inference_high_ms  # on a busy machine an estimate
    assert oidn.peak_share * at_most_ms < 1.5  # of a matrix product at another moment


def test_bytes_moved_are_those_that_operations_read_and_write():
    a, b = torch.zeros(2, 100), torch.zeros(100)
    with TrafficCounter() as traffic:
        a.view(200)[:100].add_(b)  # reads 200 values, writes 100; a view moves none
        torch.empty(100)
        (b.expand(7, 100) + a[:1]).sum()  # reads 200, writes 700; reads 700, writes 1
    assert traffic.total == 4 * (300 + 900 + 701)


def test_the_page_shows_every_size_and_how_uncertain_a_time_is(table):
    spoiled = table.copy()
    spoiled["note"] = ["the machine was busy", *[""] * (len(table) - 1)]
    for name, ms in (("", 10.0), ("low_", 8.0), ("high_", 12.0)):
        spoiled.loc[0, f"inference_{name}ms"] = ms
    page = speed_page(spoiled, "a processor")
    for text in ("## 64 x 48", "## 32 x 32", "| 10.0 ±25 % |", "`mean`: the machine was busy"):
        assert text in page
    assert page.count("`ours@openvino`") == 2


def test_the_command_writes_both_files_and_names_them(tmp_path: Path):
    out = tmp_path / "speed"
    arguments = ["speed", "-m", "mean", "--sizes", "32x16,16", "--repeats", "1", "--out", str(out)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert str(out / "speed.md") in result.output
    assert set(pd.read_csv(out / "speed.csv").width) == {32, 16}


def test_times_become_a_cost_profile_and_failures_do_not(tmp_path):
    rows = [("ours", 1080, 1920, 3.5, "busy"), ("oidn/tuned", 1080, 1920, math.nan, "no weights")]
    table = pd.DataFrame(rows, columns=["method", "height", "width", "inference_ms", "note"])
    file = tmp_path / "gpu.toml"
    write_profile(file, "GPU", (1080, 1920), 4.0, profile_times(table))
    found = read_profile(str(file))
    assert found.inference("ours", 1080, 1920).ms == 3.5
    assert found.inference("oidn/tuned", 1080, 1920) is None
    assert found.sample("any", 1080, 1920).ms == 4.0
    with pytest.raises(RlbenchError, match="no weights"):
        profile_times(table[1:])
