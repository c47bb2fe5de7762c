"""Parts of method names."""

from __future__ import annotations

import pytest

from reports.analysis import method_names


@pytest.mark.parametrize(
    ("method", "parts"),
    [
        ("ours", ("ours", "ours", "", "")),
        ("ours/A2", ("ours", "ours/A2", "", "")),
        ("ours/A2@seed12", ("ours", "ours/A2", "seed12", "ours/A2@seed")),
        ("restir+oidn@long", ("restir+oidn", "restir+oidn", "long", "restir+oidn@long")),
    ],
)
def test_a_name_has_family_method_label_and_training_series(method, parts):
    parsed = (
        method_names.family_of(method),
        method_names.without_label(method),
        method_names.label_of(method),
        method_names.training_series_of(method),
    )
    assert parsed == parts
