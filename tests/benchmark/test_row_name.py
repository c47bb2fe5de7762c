"""Names of rows: printed and parsed alike."""

from __future__ import annotations

import pytest

from rlbench.benchmark.results import RowName, RowOptions


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("ours", ("ours", "", "")),
        ("ours/A2", ("ours", "A2", "")),
        ("ours@bf16", ("ours", "", "bf16")),
        ("ours/A2@bf16-seed0", ("ours", "A2", "bf16-seed0")),
        ("restir+oidn@crossval", ("restir+oidn", "", "crossval")),
    ],
)
def test_a_name_is_parsed_as_it_is_printed(text, parts):
    assert RowName.parse(text) == RowName(*parts)
    assert str(RowName(*parts)) == text
    assert RowName.parse(text).method == text.partition("@")[0]


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("ours", RowOptions()),
        ("mean@tiles", RowOptions(skip_tiles=True)),
        ("ours@bf16", RowOptions(bf16=True)),
        ("ours@compile-bf16-tiles", RowOptions("compile", bf16=True, skip_tiles=True)),
        ("ours@bf16-seed-3", RowOptions(bf16=True, weights="seed-3")),
        ("ours@weights-bf16", RowOptions(weights="weights-bf16")),
        ("ours@crossval", RowOptions(weights="crossval")),
    ],
)
def test_a_label_says_backend_precision_tiles_and_weights(text, options):
    assert RowName.parse(text).options == options
