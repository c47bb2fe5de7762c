"""Layout files: every ready one is valid, and mistakes are named with what is allowed."""

from __future__ import annotations

import re
from pathlib import PurePath

import pytest

from rlbench.apps.dumps.importers.file_pattern import FileKey, match_pattern
from rlbench.apps.dumps.importers.layout import decode_layout, read_layout, ready_layouts
from rlbench.errors import SourceError

RIGHT = {
    "radiance": {"files": "{sample}/{frame}.exr"},
    "reference": {"files": "ref/{frame}.exr"},
    "motion": {"files": "mv/{frame}.exr"},
}


@pytest.mark.parametrize("name", ready_layouts())
def test_a_ready_layout_is_valid_and_names_its_source(name):
    assert read_layout(name).radiance.patterns
    assert ready_layouts()[name].read_text().startswith("#")


MISTAKES = {
    "an unknown table": ({"motions": {}}, "Did you mean 'motion'?"),
    "an unknown key": (
        {"motion": {"files": "a", "units": "ndc"}},
        "[motion] has the unknown key 'units'",
    ),
    "a word that is not allowed": (
        {"motion": {"files": "a", "unit": "NDC"}},
        "[motion] unit is 'NDC', expected 'pixels', 'ndc' or 'shares'",
    ),
    "a number in place of a word": (
        {"motion": {"files": "a", "y": 1}},
        "[motion] y is 1, expected 'down' or 'up'",
    ),
    "a missing key": ({"depth": {"kind": "view"}}, "[depth] needs the key 'files'"),
    "a text in place of a number": (
        {"depth": {"files": "a", "far": "1e9"}},
        "far",
    ),
    "an exposure that is neither": (
        {"exposure": "automatic"},
        "exposure is 'automatic', expected 'auto'",
    ),
    "a value in place of a table": ({"albedo": "a.exr"}, "albedo is 'a.exr', expected a table"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_a_layout_names_the_key_the_value_and_what_is_allowed(mistake):
    change, message = MISTAKES[mistake]
    with pytest.raises(SourceError, match=f"engine.toml: .*{re.escape(message)}"):
        decode_layout(RIGHT | change, "engine.toml")


def test_radiance_and_a_reference_suffice():
    tables = {name: RIGHT[name] for name in ("radiance", "reference")}
    assert set(decode_layout(tables, "engine.toml").images) == {"radiance", "reference"}


PATTERNS = {
    "{clip}.{frame}.exr": ("hall/beauty.0012.exr", FileKey("hall/beauty", 12)),
    "[sample{sample}/]*{frame}.exr": ("sample3/a0007.exr", FileKey("", 7, 3)),
    "reference[{half}]/{frame}.exr": ("referenceB/1.exr", FileKey("", 1, ord("B"))),
    "**/{frame}_{spp}spp.exr": ("a/b/4_16spp.exr", FileKey("", 4, 0, 16)),
    "{frame}/{frame}.exr": ("12/12.exr", FileKey("", 12)),
}


@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_pattern_reads_a_path(pattern):
    path, key = PATTERNS[pattern]
    assert match_pattern(pattern, PurePath(path)) == key


@pytest.mark.parametrize("path", ["a/3.exr", "3.exr.tmp", "x.exr"])
def test_a_pattern_matches_whole_paths_alone(path):
    assert match_pattern("{frame}.exr", PurePath(path)) is None


@pytest.mark.parametrize(
    ("pattern", "message"),
    [("{frames}.exr", "no placeholder {frames}; there are: {frame}"), ("[a.exr", "1 [ and 0 ]")],
)
def test_a_wrong_pattern_is_an_error(pattern, message):
    with pytest.raises(SourceError, match=re.escape(message)):
        match_pattern(pattern, PurePath("1.exr"))
