"""Camera jitter of a dump: it is taken out of motion, and its offsets are in the header."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import qmc

from rlbench.apps.dumps.importers import formats, writer
from rlbench.apps.dumps.importers.jitter import halton_offset, read_offsets
from rlbench.apps.dumps.importers.layout import Camera, decode_layout, ready_layouts
from rlbench.apps.dumps.importers.sequence import ImportedSequence
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from rlbench.apps.dumps.lint.guess import guess_layout
from rlbench.clips.header import ClipError, read_header
from rlbench.errors import SourceError
from tests.apps.dumps.importers.dumps import write_falcor
from tests.apps.dumps.lint.broken_fixtures import correct_clip


@pytest.fixture(scope="module")
def arrays() -> ClipArrays:
    return correct_clip(height=48, width=64, frames=4, half=64)


def dump_jittered(arrays: ClipArrays, folder: Path, sign: float = 1.0) -> None:
    """A dump of Falcor whose motion contains the change of the first Halton offsets."""
    offsets = torch.tensor([halton_offset(i) for i in range(len(arrays))])
    change = torch.cat([offsets[:1] - torch.tensor(halton_offset(7)), offsets.diff(dim=0)])
    motion = arrays.gbuffer["motion"] + sign * change.view(-1, 2, 1, 1)
    write_falcor(replace(arrays, gbuffer={**arrays.gbuffer, "motion": motion}), folder)


def sequence(source: Path, camera: str, motion: str = "", reference: str = "") -> ImportedSequence:
    """The sequence that Falcor's layout finds, with more keys."""
    text = ready_layouts()["falcor"].read_text()
    text = text.replace("[reference]", f"[reference]\n{reference}")
    layout = source.parent / "engine.toml"
    layout.write_text(f"{text}\n{motion}\n{camera}")
    (found,) = formats.find_sequences(source, str(layout))
    return found


def motion_of(found: ImportedSequence) -> np.ndarray:
    frames = [found.read(number, 1).gbuffer["motion"] for number in found.numbers]
    return np.moveaxis(np.stack(frames), -1, 1)


@pytest.mark.parametrize(
    ("jitter", "sign", "more"),
    [("halton 8", 1.0, ""), ("halton 8", -1.0, "scale = -1.0"), ("offsets.txt", 1.0, "")],
)
def test_methods_get_motion_without_the_jitter(arrays, tmp_path, jitter, sign, more):
    dump_jittered(arrays, tmp_path / "dump", sign)
    lines = ["# x, y", *("{}, {}".format(*halton_offset(i)) for i in range(4))]
    (tmp_path / "dump" / "offsets.txt").write_text("\n".join(lines))
    found = sequence(tmp_path / "dump", f'[camera]\njitter = "{jitter}"\n{more}', "jittered = true")
    first = 1 if jitter == "offsets.txt" else 0  # no offset is known before the first of a file
    # pixels; stored as shares of the image in single precision
    expected = arrays.gbuffer["motion"]
    np.testing.assert_allclose(motion_of(found)[first:], expected[first:], atol=1e-4)
    assert found.jitter[2] == pytest.approx([sign * v for v in halton_offset(2)])


def test_motion_that_is_without_jitter_stays_and_the_reference_is_said(arrays, tmp_path):
    write_falcor(arrays, tmp_path / "dump")
    found = sequence(tmp_path / "dump", '[camera]\njitter = "halton 16"')
    np.testing.assert_allclose(motion_of(found), arrays.gbuffer["motion"], atol=1e-4)
    assert "halton 16" in found.notes[-1]
    assert "the reference is not jittered" in found.notes[-1]


def test_offsets_are_in_the_header_and_a_jittered_reference_is_a_limitation(arrays, tmp_path):
    write_falcor(arrays, tmp_path / "dump")
    found = sequence(tmp_path / "dump", '[camera]\njitter = "halton 8"', "", "jittered = true")
    header = writer.clip_header(found, 1)
    writer.write_clip(found, header, tmp_path / "clip")
    stored = read_header(tmp_path / "clip")
    assert stored.jitter == tuple(halton_offset(i) for i in range(4))
    assert stored.limitations == ("reference jitter",)
    assert stored.digest_fields("path").keys() == header.digest_fields("path").keys()
    for wrong in (((9.0, 0.0),) * 4, ((0.0, 0.0),)):
        with pytest.raises(ClipError, match="jitter"):
            replace(header, jitter=wrong)


def test_jittered_images_need_offsets(arrays, tmp_path):
    write_falcor(arrays, tmp_path / "dump")
    with pytest.raises(SourceError, match=r"needs \[camera\] jitter"):
        sequence(tmp_path / "dump", "", "jittered = true")


def test_the_jitter_of_a_dump_is_guessed(arrays, tmp_path):
    dump_jittered(arrays, tmp_path / "dump")
    guess = guess_layout(tmp_path / "dump")
    assert guess.tables["motion"]["jittered"] is True
    assert decode_layout(guess.tables, "guess").camera == Camera(jitter="halton 8")


# The table of offsets


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2000))
def test_offsets_are_those_of_a_halton_sequence(index):
    points = qmc.Halton(2, scramble=False).fast_forward(index + 1).random(1)[0] - 0.5
    assert halton_offset(index) == pytest.approx(points, abs=1e-12)


FLOATS = st.floats(-2, 2, width=32)


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(FLOATS, FLOATS), min_size=1, max_size=20),
    st.sampled_from([" ", ", ", "\t", ";"]),
    st.booleans(),
    st.floats(-2, 2),
)
def test_a_table_of_offsets_is_read_back(tmp_path_factory, table, separator, is_up, scale):
    folder = tmp_path_factory.getbasetemp()
    lines = [f"{x!r}{separator}{y!r}  # {i}\n" for i, (x, y) in enumerate(table)]
    (folder / "table.txt").write_text("\ufeff# offsets\n\n" + "".join(lines))
    camera = Camera(jitter="table.txt", scale=scale, y="up" if is_up else "down")
    offset = read_offsets(camera, folder)
    sign = -1 if is_up else 1
    found = [offset(i) for i in range(len(table))]
    assert found == [(x * scale, y * sign * scale) for x, y in table]
    with pytest.raises(SourceError, match="line for each frame"):
        offset(len(table))


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=80))
def test_any_file_of_offsets_is_read_or_an_error(tmp_path_factory, content):
    folder = tmp_path_factory.getbasetemp()
    (folder / "any.txt").write_bytes(content)
    try:
        x, y = read_offsets(Camera(jitter="any.txt"), folder)(0)
    except SourceError:
        return
    assert max(abs(x), abs(y)) <= 2


@pytest.mark.parametrize("jitter", ["halton 0", "sobol 8", ""])
def test_a_formula_that_is_not_known_is_an_error_that_shows_one(tmp_path, jitter):
    with pytest.raises(SourceError, match="halton 16"):
        read_offsets(Camera(jitter=jitter), tmp_path)
