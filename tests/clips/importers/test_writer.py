"""`rlbench import`: doors that all formats share, resuming, and a method on what came of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from typer.testing import CliRunner

from rlbench.benchmark import results
from rlbench.cli.app import app
from rlbench.clips.importers import formats, writer
from rlbench.clips.importers.sequence import SourceError, clip_name, span
from rlbench.clips.stored import ClipError, open_clip, read_header, verify
from tests.clips.importers.sources import oidn, paper, radiance


def rlbench(*words: object, code: int = 0) -> str:
    """What a command prints, errors included."""
    found = CliRunner().invoke(app, [str(word) for word in words])
    assert found.exit_code == code, found.output
    return " ".join(found.output.split())


@pytest.fixture
def source(tmp_path):
    return oidn(tmp_path / "source")


def test_a_method_runs_on_an_imported_clip(source, tmp_path):
    out = tmp_path / "clips"
    told = rlbench("import", source, "--format", "oidn", "--out", out)
    assert "imported, 3 frames of 16 x 12, of each pixel 2 samples" in told
    rlbench("run", "-m", "mean", "--clips", out, "--spp", "2", "--out", tmp_path / "results")
    rows = results.read(tmp_path / "results")
    found = rows[rows["metric"] == "relmse"].sort_values("frame")["value"].to_numpy()
    for frame, score in enumerate(found):
        image = (radiance(frame, 0) + radiance(frame, 1)) / 2
        reference = radiance(frame, 8) + 1 / 3
        expected = ((image - reference) ** 2 / (reference**2 + 0.01)).mean()
        assert score == pytest.approx(expected, rel=1e-5)  # float
    assert len(found) == 3


def test_what_needs_two_halves_is_not_scored_on_one_reference(source, tmp_path):
    rlbench("import", source, "--format", "oidn", "--out", tmp_path / "clips")
    rlbench("run", "-m", "mean", "--clips", tmp_path / "clips", "--out", tmp_path / "r")
    rows = results.read(tmp_path / "r")
    debiased = rows[rows["metric"] == "mse_debiased"]
    assert debiased["value"].isna().all()
    assert set(debiased["note"].str.partition(",")[0]) == {
        "referenceA and referenceB are one image"
    }


def test_what_needs_two_halves_is_scored_on_two(tmp_path):
    source = oidn(tmp_path / "source", halves=True)
    rlbench("import", source, "--format", "oidn", "--out", tmp_path / "clips")
    rlbench("run", "-m", "mean", "--clips", tmp_path / "clips", "--out", tmp_path / "r")
    rows = results.read(tmp_path / "r")
    assert rows[rows["metric"] == "mse_debiased"]["value"].notna().all()


def test_an_import_says_what_is_lacking_and_what_can_run(source, tmp_path):
    told = rlbench("import", source, "--format", "oidn", "--out", tmp_path)
    assert "lacks halves: referenceA and referenceB are one image" in told
    assert "budgets up to 2 spp can be measured with: " in told
    assert "ours (reads depth, motion, the clip has: albedo, normal)" in told


def test_too_few_samples_say_which_methods_can_run(tmp_path):
    source = oidn(tmp_path / "source", seeds=1)
    words = ("import", source, "--format", "oidn", "--out", tmp_path / "out")
    told = rlbench(*words, "--samples", 8, code=2)
    assert "8 samples of each pixel are wanted, frame 0 has 1 image of 1 spp" in told
    assert "With --samples 1 budgets up to 1 spp can be measured with: " in told
    assert "mean" in told.partition("measured with:")[2].partition(";")[0]
    assert "to adapt is only to leave pixels out" in told


def test_an_imported_clip_is_sound(tmp_path):
    rlbench("import", paper(tmp_path / "s"), "--format", "paper", "--out", tmp_path / "out")
    assert verify(tmp_path / "out" / "suntemple") == []


def test_exposure_is_told_to_the_clip(source, tmp_path):
    words = ("import", source, "--format", "oidn", "--out", tmp_path, "--exposure", 2.5)
    rlbench(*words)
    assert read_header(tmp_path / "walk").exposure == 2.5


def test_clips_are_apart_in_folders_of_their_own(tmp_path):
    for name in ("day", "night"):
        oidn(tmp_path / "source" / name)
    rlbench("import", tmp_path / "source", "--format", "oidn", "--out", tmp_path / "out")
    found = {path.parent.name for path in (tmp_path / "out").glob("*/clip.toml")}
    assert found == {"day-walk", "night-walk"}


# Resuming


def _killed_after(source, folder, frames: int) -> None:
    (sequence,) = formats.sequences(source, "oidn")
    left = iter(range(frames))

    def tell() -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt

    writer.store(sequence, writer.clip_header(sequence, None), folder, tell)


def test_a_killed_import_is_unfinished(source, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        _killed_after(source, tmp_path / "out" / "walk", 1)
    with pytest.raises(ClipError, match=r"unfinished.*rlbench import"):
        open_clip(tmp_path / "out" / "walk")


def test_a_killed_import_goes_on_where_it_was(source, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        _killed_after(source, tmp_path / "out" / "walk", 1)
    done = tmp_path / "out" / "walk" / "referenceB.0000.exr"
    before = done.stat().st_mtime_ns
    for out in ("out", "whole"):
        rlbench("import", source, "--format", "oidn", "--out", tmp_path / out)
    resumed, whole = (open_clip(tmp_path / out / "walk", frozenset()) for out in ("out", "whole"))
    assert (done.stat().st_mtime_ns, resumed.digest) == (before, whole.digest)


def test_the_second_import_does_nothing_and_says_so(source, tmp_path):
    words = ("import", source, "--format", "oidn", "--out", tmp_path / "out")
    rlbench(*words)
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "out" / "walk").iterdir()}
    assert "walk: known before, 3 frames" in rlbench(*words)
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "out" / "walk").iterdir()} == before


@pytest.mark.parametrize("changed", [("--samples", 1), ("--frames", "0:2")])
def test_another_import_does_not_mix_with_what_is_there(source, tmp_path, changed):
    words = ("import", source, "--format", "oidn", "--out", tmp_path / "out")
    rlbench(*words)
    assert "holds a clip from elsewhere" in rlbench(*words, *changed, code=2)


def test_a_renderers_clip_is_not_written_over(source, clip_folder):
    clip_folder.rename(clip_folder.with_name("walk"))
    words = ("import", source, "--format", "oidn", "--out", clip_folder.parent)
    assert "holds a clip from elsewhere" in rlbench(*words, code=2)


# Doors


def test_an_unknown_format_names_those_there_are(source, tmp_path):
    told = rlbench("import", source, "--format", "pfm", "--out", tmp_path, code=2)
    assert "no format 'pfm'; there are: oidn, noisebase, paper" in told


def test_no_folder_is_an_error(tmp_path):
    with pytest.raises(SourceError, match="no folder .*nowhere"):
        formats.sequences(tmp_path / "nowhere", "oidn")


@pytest.mark.parametrize("format_", ["noisebase", "paper"])
def test_a_source_of_another_format_says_what_is_expected(source, format_):
    with pytest.raises(SourceError, match="expected files such as .*; it holds: walk_0000_seed0"):
        formats.sequences(source, format_)


@pytest.mark.parametrize("format_", list(formats.FORMATS))
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_link_that_leaves_the_source_is_not_followed(tmp_path, format_, kind):
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "key").write_text("!")
    (tmp_path / "source").mkdir()
    target = tmp_path / "secret" / ("key" if kind == "file" else "")
    (tmp_path / "source" / "frame0000.zip").symlink_to(target)
    with pytest.raises(SourceError, match=r"frame0000\.zip is a link that leaves"):
        formats.sequences(tmp_path / "source", format_)


def test_a_link_inside_the_source_is_followed(source):
    (source / "walk_0003_seed0_0001spp.hdr.exr").symlink_to("walk_0000_seed0_0001spp.hdr.exr")
    assert formats.sequences(source, "oidn", (0, 3))[0].numbers == (0, 1, 2)


@pytest.mark.parametrize("name", ["..", ".hidden", "a/b", "-o", "", "a\nb"])
def test_a_name_that_is_no_folders_is_refused(name):
    with pytest.raises(SourceError, match="cannot be a clip's name"):
        clip_name(name)


def test_a_name_in_the_source_does_not_leave_the_output(tmp_path):
    source = oidn(tmp_path / "source", frames=1)
    for path in list(source.iterdir()):
        path.rename(source / path.name.replace("walk_0000", ".."))
    (found,) = formats.sequences(source, "oidn")
    assert found.name == "source"  # dots are taken off, and the folder's name stands in


@pytest.mark.parametrize("text", ["5", "3:3", "5:2", "a:b", "-1:3"])
def test_a_span_that_is_none_is_refused(text):
    with pytest.raises(SourceError, match="FIRST:END"):
        span(text)


def test_frames_beyond_the_last_are_missing(source):
    with pytest.raises(
        SourceError, match="frames 1 to 4 are wanted and 2 of them are missing: 3, 4"
    ):
        formats.sequences(source, "oidn", (1, 5))


def test_what_is_not_finite_is_not_imported(tmp_path):
    from tests.clips.importers.sources import exr

    source = oidn(tmp_path / "source")
    image = radiance(1, 0)
    image[2, 3, 1] = math.nan
    exr(source / "walk_0001_seed0_0001spp.hdr.exr", image)
    (sequence,) = formats.sequences(source, "oidn")
    with pytest.raises(ClipError, match=r"frame 1: 1 values of pool\.path are not finite"):
        writer.store(sequence, writer.clip_header(sequence, None), tmp_path / "out")


# Precision


def test_fireflies_are_imported_whole(tmp_path):
    from tests.clips.importers.sources import exr

    source = oidn(tmp_path / "source", frames=1)
    image = radiance(0, 0)
    image[1, 1] = 3e6
    exr(source / "walk_0000_seed0_0001spp.hdr.exr", image)
    rlbench("import", source, "--format", "oidn", "--out", tmp_path / "out")
    clip = open_clip(tmp_path / "out" / "walk", frozenset())
    assert np.float32(clip.frame(0).pool.radiance.max()) == 3e6
