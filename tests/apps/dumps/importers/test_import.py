"""Imports: dumps of each engine, and the command, which resumes; measuring on an imported clip."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from rlbench.apps.dumps.importers import formats, writer
from rlbench.apps.dumps.importers.layout import ready_layouts
from rlbench.apps.dumps.lint.checks import lint_clip
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, read_clip_arrays
from rlbench.benchmark import results
from rlbench.checks.result import Verdict
from rlbench.clips.header import ClipError, read_header
from rlbench.clips.stored import open_clip, verify
from rlbench.errors import SourceError
from rlbench.system import paths
from tests.apps.dumps.exr_files import read_parts, read_planes, write_file, write_image
from tests.apps.dumps.importers.dumps import WRITERS, write_blender, write_falcor, write_own
from tests.apps.dumps.importers.sources import radiance, write_oidn, write_rl_path_tracing
from tests.cli.runner import rlbench

HALF = {"rtol": 2e-3, "atol": 2e-3}  # two roundings to half precision, of the dump and of the clip
MOTION = {"rtol": 1e-4, "atol": 1e-4}  # pixels: stored as shares of the image in single precision


def import_clip(source: Path, layout: str, out: Path) -> ClipArrays:
    (sequence,) = formats.find_sequences(source, layout)
    header = writer.clip_header(sequence, None, writer.estimate_exposure(sequence))
    writer.write_clip(sequence, header, out / sequence.name)
    return read_clip_arrays(out / sequence.name, 0)


@pytest.fixture(scope="module", params=WRITERS)
def engine(request, short, tmp_path_factory) -> tuple[str, ClipArrays]:
    """An engine's name, and the clip imported from its dump."""
    folder = tmp_path_factory.mktemp(request.param)
    WRITERS[request.param](short, folder / "dump")
    text = ready_layouts()[request.param].read_text()  # with the procedural camera's field of view
    (folder / "own.toml").write_text(text.replace("fov = 39.3077", "fov = 60.0"))
    return request.param, import_clip(folder / "dump", str(folder / "own.toml"), folder / "out")


def assert_equal_buffers(found: ClipArrays, short: ClipArrays, names: set[str]) -> None:
    for name in names:
        tolerance = MOTION if name == "motion" else HALF
        np.testing.assert_allclose(found.gbuffer[name], short.gbuffer[name], **tolerance)


def test_every_ready_layout_has_a_dump():
    assert {*WRITERS, "oidn"} == set(ready_layouts())


def test_a_dump_of_an_engine_is_the_clip_from_which_it_was_written(engine, short):
    name, found = engine
    assert_equal_buffers(found, short, set(short.gbuffer) - {"motion" * (name == "mitsuba")})
    # sample order is that of the files; samples are stored in half precision
    np.testing.assert_allclose(found.pools["path"], short.pools["path"], **HALF)
    np.testing.assert_allclose(found.half_a, short.half_a, rtol=1e-6)
    np.testing.assert_allclose(found.half_b, short.half_b, rtol=1e-6)
    assert "sky motion" not in found.header.limitations


@pytest.mark.slow
def test_the_linter_fails_no_imported_dump(engine):
    results = lint_clip(engine[1])
    assert {r.check: r.found for r in results if r.verdict is Verdict.FAILED} == {}


def test_a_layout_of_ones_own_reads_parts_means_and_other_conventions(short, tmp_path):
    found = import_clip(tmp_path / "dump", str(write_own(short, tmp_path / "dump")), tmp_path)
    # the dump holds 24 bits of a z-buffer, so distant depth is less exact than half precision
    assert_equal_buffers(found, short, {"albedo", "normal", "depth", "motion"})
    np.testing.assert_allclose(found.pools["path"].mean(1), short.pools["path"].mean(1), **HALF)
    np.testing.assert_allclose(found.half_a, short.reference, rtol=1e-6)
    assert found.header.reference_spp == (512,) * 3
    assert found.header.limitations == ("halves",)
    verdicts = {result.check: result.verdict for result in lint_clip(found)}
    assert Verdict.FAILED not in verdicts.values()
    assert verdicts["brightness"] is Verdict.PASSED


def test_the_linter_finds_the_light_that_demodulation_loses_where_albedo_is_black(short, tmp_path):
    layout = write_own(short, tmp_path / "dump")
    radiance, _, rest = layout.read_text().partition("[emission]")
    layout.write_text(radiance + rest[rest.index("[reference]") :])
    results = lint_clip(import_clip(tmp_path / "dump", str(layout), tmp_path))
    assert [r.check for r in results if r.verdict is Verdict.FAILED] == ["brightness"]


def test_frames_and_cameras_are_those_of_their_numbers(short, tmp_path):
    layout = str(write_own(short, tmp_path / "dump"))
    (sequence,) = formats.find_sequences(tmp_path / "dump", layout, (1, 3))
    normal = torch.from_numpy(sequence.read(2, 1).gbuffer["normal"]).movedim(-1, 0)
    np.testing.assert_allclose(normal, short.gbuffer["normal"][2], **HALF)


def test_a_clip_without_motion_depth_and_second_half_is_linted_with_warnings_alone(short, tmp_path):
    write_falcor(short, tmp_path / "dump")
    for pattern in ("*mvec*", "*linearZ*", "referenceB/*"):
        for path in tmp_path.rglob(pattern):
            path.unlink()
    found = import_clip(tmp_path / "dump", "falcor", tmp_path / "out")
    assert found.header.limitations == ("halves", "no depth", "no motion")
    verdicts = {result.check: result.verdict for result in lint_clip(found)}
    assert Verdict.FAILED not in verdicts.values()
    for check in ("motion", "depth", "reference halves", "noise ceiling", "independent seeds"):
        assert verdicts[check] is Verdict.WARNING


def find_with_channels(short: ClipArrays, folder: Path, old: str, new: str):
    """The sequences of Blender's dump by its layout with another channel."""
    write_blender(short, folder / "dump")
    text = ready_layouts()["blender"].read_text().replace(old, new)
    (folder / "own.toml").write_text(text)
    return formats.find_sequences(folder / "dump", str(folder / "own.toml"))


def test_a_missing_channel_is_a_note_and_a_limitation(short, tmp_path):
    (sequence,) = find_with_channels(short, tmp_path, "*.Depth.Z", "*.Mist.Z")
    assert sequence.limitations == ("no depth",)
    assert "no file has the channels of [depth]" in sequence.notes[0]


def test_a_channel_that_matches_twice_is_an_error(short, tmp_path):
    with pytest.raises(SourceError, match=r"'\*.X' matches several channels: ViewLayer.Normal.X"):
        find_with_channels(short, tmp_path, "*.Normal.X", "*.X")


# Blender's recipe


def blender_recipe(short: ClipArrays, folder: Path) -> Path:
    """Samples from 1, without depth; buffers in a folder of their own; several layers."""
    write_blender(short, folder)
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


def test_blenders_recipe_reads_buffers_from_geometry_and_samples_from_one_layer(short, tmp_path):
    dump = blender_recipe(short, tmp_path / "dump")
    with pytest.raises(SourceError, match="several channels: Other.Combined.R, ViewLayer"):
        formats.find_sequences(dump, "blender")
    (sequence,) = formats.find_sequences(dump, "blender", layer="ViewLayer")
    assert sequence.counts == (7, 7, 7)
    frame = sequence.read(2, 7)
    expected = short.pools["path"][1, 1:].movedim(1, -1)
    np.testing.assert_allclose(frame.pool, expected, **HALF)
    depth = short.gbuffer["depth"][1].movedim(0, -1)
    np.testing.assert_allclose(frame.gbuffer["depth"], depth, **HALF)
    (other,) = formats.find_sequences(dump, "blender", layer="Other")
    np.testing.assert_allclose(other.read(2, 7).pool, 2 * expected, **HALF)


def test_a_part_that_one_frame_of_many_lacks_is_named(short, tmp_path):
    layout = write_own(short, tmp_path / "dump")
    path = tmp_path / "dump" / "1" / "all.exr"
    parts = {header["name"]: planes for header, planes in read_parts(path)}
    write_file(path, {name: planes for name, planes in parts.items() if name != "converged"})
    with pytest.raises(SourceError, match="1/all.exr: .* in the part 'converged'; it has: emiss"):
        formats.find_sequences(tmp_path / "dump", str(layout))


# The command


@pytest.fixture
def out(tmp_path) -> Path:
    return tmp_path / "clips"


def import_oidn(source: Path, out: Path, *words: object, code: int = 0) -> str:
    return rlbench("import", source, "--format", "oidn", "--out", out, *words, code=code)


def times(folder: Path, pattern: str = "*") -> dict[str, int]:
    """When the files of a clip were written."""
    return {path.name: path.stat().st_mtime_ns for path in folder.glob(pattern)}


def test_a_method_runs_on_an_imported_clip(source, tmp_path, out):
    output = import_oidn(source, out, "--exposure", 1)
    assert "imported, 3 frames of 16 x 12" in output
    assert "2 samples" in output
    rlbench("run", "-m", "mean", "--clips", out, "--spp", "2", "--out", tmp_path / "results")
    rows = results.read(tmp_path / "results")
    scores = rows[rows["metric"] == "relmse"].sort_values("frame")["value"].to_numpy()
    for frame, score in enumerate(scores):
        image = (radiance(frame, 0) + radiance(frame, 1)) / 2
        reference = radiance(frame, 8) + 1 / 3
        expected = ((image - reference) ** 2 / (reference**2 + 0.01)).mean()
        assert score == pytest.approx(expected, rel=1e-5)  # float
    assert len(scores) == 3


@pytest.mark.parametrize("halves", [False, True])
def test_a_metric_that_needs_two_halves_is_scored_on_two_alone(tmp_path, out, halves):
    import_oidn(write_oidn(tmp_path / "source", halves=halves), out)
    rlbench("run", "-m", "mean", "--clips", out, "--out", tmp_path / "r")
    rows = results.read(tmp_path / "r").query("metric == 'mse_debiased'")
    assert (rows["value"].notna() == halves).all()
    note = "" if halves else "referenceA and referenceB are one image"
    assert set(rows["note"].fillna("").str.partition(",")[0]) == {note}


def test_an_import_lists_limitations_and_the_methods_that_can_run(source, out):
    output = import_oidn(source, out)
    assert "halves: referenceA and referenceB are one image" in output
    assert "no motion: the source has no motion, so motion is a constant" in output
    methods = output.partition("budgets up to 2 spp can be measured with: ")[2]
    assert "ours," in methods.partition(";")[0]


def test_a_message_about_too_few_samples_lists_the_methods_that_can_run(tmp_path, out):
    output = import_oidn(write_oidn(tmp_path / "s", seeds=1), out, "--samples", 8, code=2)
    assert "8 samples per pixel requested, frame 0 has 1 image of 1 spp" in output
    methods = output.partition("With --samples 1 budgets up to 1 spp can be measured with: ")[2]
    assert "mean" in methods.partition(";")[0]


def test_the_former_name_of_a_format_is_accepted_and_the_clip_is_valid(tmp_path, out):
    source = write_rl_path_tracing(tmp_path / "s")
    rlbench("import", source, "--format", "paper", "--out", out)
    assert verify(out / "suntemple") == []


def test_another_exposure_of_a_finished_import_changes_the_header_alone(source, out):
    import_oidn(source, out, "--exposure", 1)
    before = read_header(out / "walk")
    assert before.exposure == 1
    images = times(out / "walk", "*.exr")
    output = import_oidn(source, out, "--exposure", 4)
    assert "before, its exposure 1 is replaced, 3 frames" in output
    assert repr(read_header(out / "walk")) == repr(replace(before, exposure=4.0))
    assert times(out / "walk", "*.exr") == images
    written = times(out / "walk")
    assert "is replaced" not in import_oidn(source, out, "--exposure", 4)
    assert "walk: was imported before, 3 frames" in import_oidn(source, out)
    assert times(out / "walk") == written


def test_an_exposure_that_float32_cannot_hold_leaves_a_finished_import_as_it_is(tmp_path, out):
    source = write_oidn(tmp_path / "source", frames=1)
    write_image(source / "walk_0000_ref.hdr.exr", np.full_like(radiance(0, 0), 3e38))
    import_oidn(source, out, "--exposure", 1)
    output = import_oidn(source, out, "--exposure", 2, code=2)
    assert "times the exposure 2 exceeds float32" in output
    assert read_header(out / "walk").exposure == 1


def test_each_clip_has_a_folder_of_its_own(tmp_path, out):
    for name in ("day", "night"):
        write_oidn(tmp_path / "source" / name)
    import_oidn(tmp_path / "source", out)
    assert {path.parent.name for path in out.glob("*/clip.toml")} == {"day-walk", "night-walk"}


# Resuming


def _interrupt_after(source: Path, folder: Path, frames: int) -> None:
    (sequence,) = formats.find_sequences(source, "oidn")
    remaining = iter(range(frames))

    def interrupt() -> None:
        if next(remaining, None) is None:
            raise KeyboardInterrupt

    writer.write_clip(sequence, writer.clip_header(sequence, None), folder, interrupt)


def test_an_interrupted_import_resumes_and_gives_the_same_clip(source, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        _interrupt_after(source, tmp_path / "out" / "walk", 1)
    with pytest.raises(ClipError, match=r"unfinished.*rlbench import"):
        open_clip(tmp_path / "out" / "walk")
    first = tmp_path / "out" / "walk" / "referenceB.0000.exr"
    before = first.stat().st_mtime_ns
    for out in ("out", "again"):
        import_oidn(source, tmp_path / out)
    resumed, again = (open_clip(tmp_path / out / "walk", frozenset()) for out in ("out", "again"))
    assert (first.stat().st_mtime_ns, resumed.digest) == (before, again.digest)


@pytest.mark.parametrize("changed", [("--samples", 1), ("--frames", "0:2")])
def test_another_import_does_not_write_into_an_existing_clip(source, out, changed):
    import_oidn(source, out)
    assert "holds a clip from elsewhere" in import_oidn(source, out, *changed, code=2)


# What would not come back, and where nothing is written


@pytest.mark.parametrize("image", ["seed0_0001spp", "ref"])
def test_radiance_that_could_not_be_read_back_is_not_imported(source, out, image):
    pixels = radiance(1, 0)
    pixels[2, 3, 1] = 3e38
    write_image(source / f"walk_0001_{image}.hdr.exr", pixels)
    output = import_oidn(source, out, "--exposure", 2, code=2)
    assert "times the exposure 2 exceeds float32" in output
    assert not (out / "walk" / "view.0001.exr").exists()


def test_a_clip_is_not_written_through_a_link(source, tmp_path, out):
    (tmp_path / "elsewhere").mkdir()
    out.mkdir()
    (out / "walk").symlink_to(tmp_path / "elsewhere")
    assert "walk is a link, to" in import_oidn(source, out, code=2)
    assert list((tmp_path / "elsewhere").iterdir()) == []


@pytest.mark.parametrize("files", [0, 5])
def test_a_full_disk_is_one_line_and_the_import_resumes(source, out, monkeypatch, files):
    remaining = iter(range(files))

    def fail_after(path) -> None:
        if next(remaining, None) is None:
            raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full_disk:
        full_disk.setattr(paths, "_synchronize", fail_after)
        output = import_oidn(source, out, code=2)
    assert "No space left on device" in output
    assert "bytes free, free some space, or choose another folder" in output
    assert [path for path in (out / "walk").iterdir() if path.name.startswith(".")] == []
    assert not (out / "walk" / "clip.toml").exists()
    import_oidn(source, out)
    assert verify(out / "walk") == []
