"""Layout files: mistakes are named with what is allowed; patterns read paths."""

from __future__ import annotations

import re
from pathlib import PurePath

import pytest

from rlbench.apps.dumps.importers.file_pattern import FileKey, match_pattern
from rlbench.apps.dumps.importers.layout import decode_layout
from rlbench.errors import SourceError

RIGHT = {"radiance": {"files": "{sample}/{frame}.exr"}, "motion": {"files": "mv/{frame}.exr"}}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motions": {}}, "Did you mean 'motion'?"),
        ({"motion": {"files": "a", "units": "ndc"}}, "[motion] has the unknown key 'units'"),
        ({"motion": {"files": "a", "y": 1}}, "[motion] y is 1, expected 'down' or 'up'"),
        ({"depth": {"kind": "view"}}, "[depth] needs the key 'files'"),
        ({"depth": {"files": "a", "far": "1e9"}}, "far"),
        ({"exposure": "automatic"}, "exposure is 'automatic', expected 'auto'"),
        ({"albedo": "a.exr"}, "albedo is 'a.exr', expected a table"),
    ],
)
def test_a_mistake_in_a_layout_names_the_key_the_value_and_what_is_allowed(change, message):
    with pytest.raises(SourceError, match=f"engine.toml: .*{re.escape(message)}"):
        decode_layout(RIGHT | change, "engine.toml")


@pytest.mark.parametrize(
    ("pattern", "path", "key"),
    [
        ("{clip}.{frame}.exr", "hall/beauty.0012.exr", FileKey("hall/beauty", 12)),
        ("[sample{sample}/]*{frame}.exr", "sample3/a0007.exr", FileKey("", 7, 3)),
        ("reference[{half}]/{frame}.exr", "referenceB/1.exr", FileKey("", 1, ord("B"))),
        ("**/{frame}_{spp}spp.exr", "a/b/4_16spp.exr", FileKey("", 4, 0, 16)),
        ("{frame}/{frame}.exr", "12/12.exr", FileKey("", 12)),
        ("{frame}.exr", "a/3.exr", None),
        ("{frame}.exr", "3.exr.tmp", None),
        ("{frame}.exr", "x.exr", None),
    ],
)
def test_a_pattern_reads_a_path_and_matches_it_to_its_ends(pattern, path, key):
    assert match_pattern(pattern, PurePath(path)) == key


@pytest.mark.parametrize(
    ("pattern", "message"),
    [("{frames}.exr", "no placeholder {frames}; there are: {frame}"), ("[a.exr", "1 [ and 0 ]")],
)
def test_a_wrong_pattern_is_an_error(pattern, message):
    with pytest.raises(SourceError, match=re.escape(message)):
        match_pattern(pattern, PurePath("1.exr"))
