"""Dumps in the layout of each engine: what is imported is the clip from which they were written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from rlbench.apps.dumps.importers import formats, writer
from rlbench.apps.dumps.importers.layout import ready_layouts
from rlbench.apps.dumps.lint.checks import lint_clip
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, read_clip_arrays
from rlbench.checks.result import Verdict
from rlbench.errors import SourceError
from tests.apps.dumps.exr_files import read_parts, read_planes, write_file
from tests.apps.dumps.importers.dumps import WRITERS, write_blender, write_falcor, write_own
from tests.apps.dumps.lint.broken_fixtures import correct_clip

HALF = {"rtol": 2e-3, "atol": 2e-3}  # two roundings to half precision, of the dump and of the clip
MOTION = {"rtol": 1e-4, "atol": 1e-4}  # pixels: stored as shares of the image in single precision


@pytest.fixture(scope="module")
def arrays() -> ClipArrays:
    return correct_clip(frames=3)


def imported(source: Path, layout: str, out: Path) -> ClipArrays:
    (sequence,) = formats.find_sequences(source, layout)
    header = writer.clip_header(sequence, None, writer.estimate_exposure(sequence))
    writer.write_clip(sequence, header, out / sequence.name)
    return read_clip_arrays(out / sequence.name, 0)


def layout_for(name: str, folder: Path) -> str:
    """The ready layout, with the field of view of the procedural camera."""
    if name != "mitsuba":
        return name
    folder.mkdir()
    text = ready_layouts()[name].read_text().replace("fov = 39.3077", "fov = 60.0")
    (folder / "mitsuba.toml").write_text(text)
    return str(folder / "mitsuba.toml")


@pytest.fixture(scope="module", params=WRITERS)
def engine(request, arrays, tmp_path_factory) -> tuple[str, ClipArrays]:
    """An engine's name, and the clip imported from its dump."""
    folder = tmp_path_factory.mktemp(request.param)
    WRITERS[request.param](arrays, folder / "dump")
    layout = layout_for(request.param, folder / "layout")
    return request.param, imported(folder / "dump", layout, folder / "out")


def assert_equal_buffers(found: ClipArrays, arrays: ClipArrays, names: set[str]) -> None:
    for name in names:
        tolerance = MOTION if name == "motion" else HALF
        np.testing.assert_allclose(found.gbuffer[name], arrays.gbuffer[name], **tolerance)


def test_every_ready_layout_has_a_dump():
    assert set(WRITERS) == set(ready_layouts())


def test_a_dump_of_an_engine_is_the_clip_from_which_it_was_written(engine, arrays):
    name, found = engine
    absent = {"oidn": {"depth", "motion"}, "mitsuba": {"motion"}}.get(name, set())
    assert_equal_buffers(found, arrays, set(arrays.gbuffer) - absent)
    # sample order is that of the files; samples are stored in half precision
    np.testing.assert_allclose(found.pools["path"], arrays.pools["path"], **HALF)
    np.testing.assert_allclose(found.half_a, arrays.half_a, rtol=1e-6)
    np.testing.assert_allclose(found.half_b, arrays.half_b, rtol=1e-6)
    assert "sky motion" not in found.header.limitations


@pytest.mark.slow
def test_the_linter_fails_no_imported_dump(engine):
    results = lint_clip(engine[1])
    assert {r.check: r.found for r in results if r.verdict is Verdict.FAILED} == {}


def test_a_layout_of_ones_own_reads_parts_means_and_other_conventions(arrays, tmp_path):
    found = imported(tmp_path / "dump", str(write_own(arrays, tmp_path / "dump")), tmp_path)
    # the dump holds 24 bits of a z-buffer, so distant depth is less exact than half precision
    assert_equal_buffers(found, arrays, {"albedo", "normal", "depth", "motion"})
    np.testing.assert_allclose(found.pools["path"].mean(1), arrays.pools["path"].mean(1), **HALF)
    np.testing.assert_allclose(found.half_a, arrays.reference, rtol=1e-6)
    assert found.header.reference_spp == (512,) * 3
    assert found.header.limitations == ("halves",)
    verdicts = {result.check: result.verdict for result in lint_clip(found)}
    assert Verdict.FAILED not in verdicts.values()
    assert verdicts["brightness"] is Verdict.PASSED


def test_the_linter_finds_the_light_that_demodulation_loses_where_albedo_is_black(arrays, tmp_path):
    layout = write_own(arrays, tmp_path / "dump")
    radiance, _, rest = layout.read_text().partition("[emission]")
    layout.write_text(radiance + rest[rest.index("[reference]") :])
    results = lint_clip(imported(tmp_path / "dump", str(layout), tmp_path))
    assert [r.check for r in results if r.verdict is Verdict.FAILED] == ["brightness"]


def test_frames_and_cameras_are_those_of_their_numbers(arrays, tmp_path):
    layout = str(write_own(arrays, tmp_path / "dump"))
    (sequence,) = formats.find_sequences(tmp_path / "dump", layout, (1, 3))
    normal = torch.from_numpy(sequence.read(2, 1).gbuffer["normal"]).movedim(-1, 0)
    np.testing.assert_allclose(normal, arrays.gbuffer["normal"][2], **HALF)


def test_a_clip_without_motion_depth_and_second_half_is_linted_with_warnings_alone(
    arrays, tmp_path
):
    write_falcor(arrays, tmp_path / "dump")
    for pattern in ("*mvec*", "*linearZ*", "referenceB/*"):
        for path in tmp_path.rglob(pattern):
            path.unlink()
    found = imported(tmp_path / "dump", "falcor", tmp_path / "out")
    assert found.header.limitations == ("halves", "no depth", "no motion")
    verdicts = {result.check: result.verdict for result in lint_clip(found)}
    assert Verdict.FAILED not in verdicts.values()
    for check in ("motion", "depth", "reference halves", "noise ceiling", "independent seeds"):
        assert verdicts[check] is Verdict.WARNING


def find_with_channels(arrays: ClipArrays, folder: Path, old: str, new: str):
    """The sequences of Blender's dump by its layout with another channel."""
    write_blender(arrays, folder / "dump")
    text = ready_layouts()["blender"].read_text().replace(old, new)
    (folder / "own.toml").write_text(text)
    return formats.find_sequences(folder / "dump", str(folder / "own.toml"))


def test_a_missing_channel_is_a_note_and_a_limitation(arrays, tmp_path):
    (sequence,) = find_with_channels(arrays, tmp_path, "*.Depth.Z", "*.Mist.Z")
    assert sequence.limitations == ("no depth",)
    assert "no file has the channels of [depth]" in sequence.notes[0]


def test_a_channel_that_matches_twice_is_an_error(arrays, tmp_path):
    with pytest.raises(SourceError, match=r"'\*.X' matches several channels: ViewLayer.Normal.X"):
        find_with_channels(arrays, tmp_path, "*.Normal.X", "*.X")


# Blender's recipe


def blender_recipe(arrays: ClipArrays, folder: Path) -> Path:
    """Samples from 1, without depth; buffers in a folder of their own; several layers."""
    write_blender(arrays, folder)
    (folder / "sample0").rename(folder / "geometry")
    for path in folder.glob("sample*/*.exr"):
        stored = read_planes(path)
        view = {name: plane for name, plane in stored.items() if "Combined" in name}
        view["ViewLayer.Depth.Z"] = np.zeros_like(stored["ViewLayer.Depth.Z"])
        layers = {
            name.replace("ViewLayer", layer): plane * factor
            for name, plane in view.items()
            for layer, factor in (("ViewLayer", 1), ("Composite", 0.5), ("Other", 2))
        }
        write_file(path, {"": layers})
    return folder


def test_blenders_recipe_reads_buffers_from_geometry_and_samples_from_one_layer(arrays, tmp_path):
    dump = blender_recipe(arrays, tmp_path / "dump")
    with pytest.raises(SourceError, match="several channels: Other.Combined.R, ViewLayer"):
        formats.find_sequences(dump, "blender")
    (sequence,) = formats.find_sequences(dump, "blender", layer="ViewLayer")
    assert sequence.counts == (7, 7, 7)
    frame = sequence.read(2, 7)
    expected = arrays.pools["path"][1, 1:].movedim(1, -1)
    np.testing.assert_allclose(frame.pool, expected, **HALF)
    depth = arrays.gbuffer["depth"][1].movedim(0, -1)
    np.testing.assert_allclose(frame.gbuffer["depth"], depth, **HALF)
    (other,) = formats.find_sequences(dump, "blender", layer="Other")
    np.testing.assert_allclose(other.read(2, 7).pool, 2 * expected, **HALF)


def test_a_part_that_one_frame_of_many_lacks_is_named(arrays, tmp_path):
    layout = write_own(arrays, tmp_path / "dump")
    path = tmp_path / "dump" / "1" / "all.exr"
    parts = {header["name"]: planes for header, planes in read_parts(path)}
    write_file(path, {name: planes for name, planes in parts.items() if name != "converged"})
    with pytest.raises(SourceError, match="1/all.exr: .* in the part 'converged'; it has: emiss"):
        formats.find_sequences(tmp_path / "dump", str(layout))
