"""Names of files and layouts: frames of any sign and padding; reasons for what is left out."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePath

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rlbench.apps.dumps.importers import formats
from rlbench.apps.dumps.importers.file_pattern import FileKey, SignReader, match_pattern
from rlbench.apps.dumps.importers.layout import decode_layout
from rlbench.apps.dumps.importers.sequence import clip_name, parse_frame_range
from rlbench.clips.header import is_plain_name
from rlbench.errors import SourceError
from tests.apps.dumps.exr_files import write_file
from tests.cli.runner import rlbench

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


PLAIN = """
[radiance]
files = "s{sample}/b.{frame}.exr"
[reference]
files = "r{half}/b.{frame}.exr"
"""


def write_grey(path: Path, value: float, prefix: str = "") -> None:
    grey = np.full((8, 12), value, np.float32)
    write_file(path, {"": {f"{prefix}{letter}": grey for letter in "RGB"}})


def write_plain(folder: Path, frames=(1, 2), places=("s0", "s1", "rA", "rB")) -> tuple[Path, str]:
    """A dump, and the file of its layout."""
    for place in places:
        for frame in frames:
            write_grey(folder / "dump" / place / f"b.{frame}.exr", 0.5)
    (folder / "engine.toml").write_text(PLAIN)
    return folder / "dump", str(folder / "engine.toml")


def reasons(source: Path, layout: str, samples: int = 2, frames=None) -> list[str]:
    drawn = [(each, samples) for each in formats.find_sequences(source, layout, frames)]
    return formats.describe_left_out(source, layout, drawn, frames)


def write_shots(folder: Path, names: list[str]) -> None:
    """Samples and references with these names, whose values are 1, 2 and so on."""
    for value, name in enumerate(names, 1):
        for place in ("sample0", "reference"):
            write_grey(folder / place / f"{name}.exr", value, "V.Combined.")


@pytest.mark.parametrize(
    "names",
    [
        ["shot-0002", "shot-0001", "shot0000", "shot0001"],  # a sign
        ["b.-2", "b.-1", "b.0", "b.1"],
        ["shot-0000", "shot-0001", "shot-0002"],  # no frame is -0
        ["shot-1001", "shot-1002"],  # far from 0
        ["shot--2", "shot--1", "shot-0"],  # a dash and a sign
        ["-002", "-001"],
    ],
)
def test_a_minus_is_a_sign_or_a_dash_as_the_other_files_show(tmp_path, names):
    write_shots(tmp_path, names)
    (sequence,) = formats.find_sequences(tmp_path, "blender")
    means = [sequence.read(number, 1).half_a.mean() for number in sequence.numbers]
    assert means == list(range(1, len(names) + 1))


def test_frames_that_may_be_negative_or_after_a_dash_are_an_error_that_says_how_to_decide(tmp_path):
    write_shots(tmp_path, ["shot-0001", "shot-0002"])
    with pytest.raises(SourceError, match="frame -1, or frame 1 after a dash.*shot-{frame}"):
        formats.find_sequences(tmp_path, "blender")


def test_a_folder_that_cannot_be_read_is_an_error(tmp_path, monkeypatch):
    source, layout = write_plain(tmp_path)
    closed = source / "s1" / "more"
    closed.mkdir()
    scandir = os.scandir

    def refuse(path):
        if Path(path) == closed:
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    with pytest.raises(SourceError, match="more cannot be read"):
        formats.find_sequences(source, layout)


def test_every_file_is_read_or_left_out_with_its_reason(tmp_path):
    source, layout = write_plain(tmp_path, places=("s0", "s1", "rA", "rB", "a0", "a1"))
    Path(layout).write_text(PLAIN + '[albedo]\nfiles = "a{sample}/b.{frame}.exr"\n')
    for name in ("rC/b.1", "rA/b.3", "rA/b.4"):
        write_grey(source / f"{name}.exr", 1)
    (source / "notes.txt").write_text("?")
    (source / "linked").symlink_to(source / "s0")
    (source / "gone").symlink_to(source / "nowhere")
    assert reasons(source, layout) == [
        "  left out, [albedo], of which one is read of each frame, that of the first sample:"
        " a1/b.1.exr to a1/b.2.exr (2 files)",
        "  left out, not a file: gone",
        "  left out, a link to a folder, which is not entered: linked",
        "  left out, no pattern of the layout matches: notes.txt",
        "  left out, [reference] of a frame without [radiance]: rA/b.3.exr to rA/b.4.exr (2 files)",
        "  left out, [reference], of which two are read of each frame, those with the most samples:"
        " rC/b.1.exr",
        f"8 files of {source} are left out",
    ]
    assert formats.find_sequences(source, layout)[0].limitations[:1] != ("halves",)


def test_samples_and_frames_that_were_not_asked_for_are_left_out(tmp_path):
    source, layout = write_plain(tmp_path, (1, 2, 3), ("s0", "s1", "rA"))
    found = " ".join(reasons(source, layout, 1, (1, 3)))
    assert "not in --frames: rA/b.3.exr" in found
    assert "not in --frames: s0/b.3.exr to s1/b.3.exr (2 files)" in found
    assert "the first 1 samples of its pixel: s1/b.1.exr to s1/b.2.exr (2 files)" in found
    assert found.endswith(f"5 files of {source} are left out")


@pytest.mark.parametrize("samples", ["separate", "accumulated"])
def test_means_of_several_samples_are_separated_or_left_out(tmp_path, samples):
    for spp in (1, 2, 4):
        write_grey(tmp_path / "dump" / f"spp{spp}" / "b.1.exr", 1)
    write_grey(tmp_path / "dump" / "ref.1.exr", 1)
    layout = tmp_path / "engine.toml"
    layout.write_text(
        f'[radiance]\nfiles = "spp{{spp}}/b.{{frame}}.exr"\nsamples = "{samples}"\n'
        '[reference]\nfiles = "ref.{frame}.exr"\n'
    )
    found = " ".join(reasons(tmp_path / "dump", str(layout)))
    assert ("spp2" in found) == (samples == "separate")
    assert "spp4" in found


def test_the_last_line_of_an_import_counts_what_is_left_out(tmp_path):
    source, layout = write_plain(tmp_path)
    write_grey(source / "rA" / "b.3.exr", 1)
    output = rlbench("import", source, "--layout", layout, "--out", tmp_path / "clips")
    assert output.endswith(f" 1 file of {source} is left out")


@pytest.mark.parametrize("where", ["above", "below"])
def test_a_source_one_level_off_is_answered_with_the_folder_that_was_meant(tmp_path, where):
    source, layout = write_plain(tmp_path)
    other = {"above": tmp_path, "below": source / "s0"}[where]
    with pytest.raises(SourceError, match=f"Did you mean rlbench import {source}"):
        formats.find_sequences(other, layout)


# Patterns: what was put into a name is read from it


NUMBERS = st.integers(-(10**6), 10**6)


@settings(max_examples=200)
@given(
    NUMBERS, st.integers(0, 9999), st.integers(1, 9), st.sampled_from(["", "_", ".", "a_", "x."])
)
def test_a_number_of_any_sign_and_padding_is_read_from_a_name(frame, sample, width, before):
    name = f"s{sample}/{before}{'-' * (frame < 0)}{abs(frame):0{width}d}.exr"
    assert match_pattern("s{sample}/*{frame}.exr", PurePath(name))[1:3] == (frame, sample)


@settings(max_examples=200)
@given(st.sets(NUMBERS, min_size=1, max_size=6), st.sampled_from(["shot", "a1x", "take_2b"]))
def test_signs_are_kept_where_a_name_without_one_is_beside_them(frames, word):
    assume(max(frames) >= 0)
    paths = {f: PurePath(f"{word}{'-' * (f < 0)}{abs(f):04d}.exr") for f in frames}
    reader = SignReader(paths.values(), ["*{frame}.exr"])
    assert {f: reader.match("*{frame}.exr", p).frame for f, p in paths.items()} == {
        f: f for f in frames
    }


@settings(max_examples=50)
@given(st.text(), st.text())
def test_any_pattern_and_name_match_or_not_without_another_error(pattern, name):
    try:
        found = match_pattern(pattern, PurePath(name))
    except SourceError:
        return
    assert found is None or found.spp >= 0


# Names of clips and ranges of frames


NAMES = ["..", ".hidden", "a/b", "-o", "", "a\nb", "render (1)", "render [1]", "\u0e17", "x" * 300]


def test_any_name_becomes_that_of_a_clip_and_another_one_for_another():
    names = [clip_name(name) for name in NAMES]
    assert all(is_plain_name(name) for name in names)
    assert len(set(names)) == len(NAMES)
    assert clip_name("Ku\u0308che") == clip_name("K\u00fcche") == "K\u00fcche"


@pytest.mark.parametrize("text", ["5", "3:3", "3:-1", "--1:3"])
def test_an_invalid_range_of_frames_is_an_error(text):
    with pytest.raises(SourceError, match="FIRST:END"):
        parse_frame_range(text)
