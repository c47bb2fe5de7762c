"""`rlbench import`: writing and resuming clips, and measuring a method on an imported clip."""

from __future__ import annotations

import errno
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from rlbench.apps.dumps.importers import formats, writer
from rlbench.benchmark import results
from rlbench.cli.app import app
from rlbench.clips.header import ClipError, read_header
from rlbench.clips.stored import open_clip, verify
from rlbench.system import paths
from tests.apps.dumps.importers.sources import exr, radiance, write_oidn, write_rl_path_tracing


def rlbench(*words: object, code: int = 0) -> str:
    """The output of a command, errors included."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == code, result.output
    return " ".join(result.output.split())


def test_a_method_runs_on_an_imported_clip(source, tmp_path):
    out = tmp_path / "clips"
    words = ("import", source, "--format", "oidn", "--out", out, "--exposure", 1)
    output = rlbench(*words)
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


def test_a_metric_that_needs_two_halves_is_not_scored_on_a_single_reference(source, tmp_path):
    rlbench("import", source, "--format", "oidn", "--out", tmp_path / "clips")
    rlbench("run", "-m", "mean", "--clips", tmp_path / "clips", "--out", tmp_path / "r")
    rows = results.read(tmp_path / "r")
    debiased = rows[rows["metric"] == "mse_debiased"]
    assert debiased["value"].isna().all()
    assert set(debiased["note"].str.partition(",")[0]) == {
        "referenceA and referenceB are one image"
    }


def test_a_metric_that_needs_two_halves_is_scored_on_two(tmp_path):
    source = write_oidn(tmp_path / "source", halves=True)
    rlbench("import", source, "--format", "oidn", "--out", tmp_path / "clips")
    rlbench("run", "-m", "mean", "--clips", tmp_path / "clips", "--out", tmp_path / "r")
    rows = results.read(tmp_path / "r")
    assert rows[rows["metric"] == "mse_debiased"]["value"].notna().all()


def test_an_import_lists_limitations_and_the_methods_that_can_run(source, tmp_path):
    output = rlbench("import", source, "--format", "oidn", "--out", tmp_path)
    assert "halves: referenceA and referenceB are one image" in output
    assert "budgets up to 2 spp can be measured with: " in output
    assert "no motion: the source has no motion, so motion is a constant" in output
    assert "ours," in output.partition("measured with: ")[2].partition(";")[0]


def test_a_message_about_too_few_samples_lists_the_methods_that_can_run(tmp_path):
    source = write_oidn(tmp_path / "source", seeds=1)
    words = ("import", source, "--format", "oidn", "--out", tmp_path / "out")
    output = rlbench(*words, "--samples", 8, code=2)
    assert "8 samples per pixel requested, frame 0 has 1 image of 1 spp" in output
    assert "With --samples 1 budgets up to 1 spp can be measured with: " in output
    assert "mean" in output.partition("measured with:")[2].partition(";")[0]
    assert "an adaptive method can only leave pixels out" in output


def test_the_former_name_of_a_format_is_accepted_and_the_clip_is_valid(tmp_path):
    source = write_rl_path_tracing(tmp_path / "s")
    rlbench("import", source, "--format", "paper", "--out", tmp_path / "out")
    assert verify(tmp_path / "out" / "suntemple") == []


def test_another_exposure_of_a_finished_import_changes_the_header_alone(source, tmp_path):
    words = ("import", source, "--format", "oidn", "--out", tmp_path)
    rlbench(*words, "--exposure", 1)
    before = read_header(tmp_path / "walk")
    assert before.exposure == 1
    images = {p: p.stat().st_mtime_ns for p in (tmp_path / "walk").glob("*.exr")}
    assert "before, its exposure 1 is replaced, 3 frames" in rlbench(*words, "--exposure", 4)
    assert repr(read_header(tmp_path / "walk")) == repr(replace(before, exposure=4.0))
    header = (tmp_path / "walk" / "clip.toml").stat().st_mtime_ns
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "walk").glob("*.exr")} == images
    assert "is replaced" not in rlbench(*words, "--exposure", 4)
    rlbench(*words)
    assert (tmp_path / "walk" / "clip.toml").stat().st_mtime_ns == header


def test_an_exposure_that_float32_cannot_hold_leaves_a_finished_import_as_it_is(tmp_path):
    source = write_oidn(tmp_path / "source", frames=1)
    exr(source / "walk_0000_ref.hdr.exr", np.full_like(radiance(0, 0), 3e38))
    words = ("import", source, "--format", "oidn", "--out", tmp_path / "out")
    rlbench(*words, "--exposure", 1)
    assert "times the exposure 2 exceeds float32" in rlbench(*words, "--exposure", 2, code=2)
    assert read_header(tmp_path / "out" / "walk").exposure == 1


def test_each_clip_has_a_folder_of_its_own(tmp_path):
    for name in ("day", "night"):
        write_oidn(tmp_path / "source" / name)
    rlbench("import", tmp_path / "source", "--format", "oidn", "--out", tmp_path / "out")
    names = {path.parent.name for path in (tmp_path / "out").glob("*/clip.toml")}
    assert names == {"day-walk", "night-walk"}


# Resuming


def _interrupt_after(source, folder, frames: int) -> None:
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
        rlbench("import", source, "--format", "oidn", "--out", tmp_path / out)
    resumed, again = (open_clip(tmp_path / out / "walk", frozenset()) for out in ("out", "again"))
    assert (first.stat().st_mtime_ns, resumed.digest) == (before, again.digest)


def test_a_second_import_writes_nothing(source, tmp_path):
    words = ("import", source, "--format", "oidn", "--out", tmp_path / "out")
    rlbench(*words)
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "out" / "walk").iterdir()}
    assert "walk: was imported before, 3 frames" in rlbench(*words)
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "out" / "walk").iterdir()} == before


@pytest.mark.parametrize("changed", [("--samples", 1), ("--frames", "0:2")])
def test_another_import_does_not_write_into_an_existing_clip(source, tmp_path, changed):
    words = ("import", source, "--format", "oidn", "--out", tmp_path / "out")
    rlbench(*words)
    assert "holds a clip from elsewhere" in rlbench(*words, *changed, code=2)


# What would not come back, and where nothing is written


@pytest.mark.parametrize("image", ["seed0_0001spp", "ref"])
def test_radiance_that_could_not_be_read_back_is_not_imported(tmp_path, image):
    source = write_oidn(tmp_path / "source")
    pixels = radiance(1, 0)
    pixels[2, 3, 1] = 3e38
    exr(source / f"walk_0001_{image}.hdr.exr", pixels)
    words = ("import", source, "--format", "oidn", "--out", tmp_path / "out", "--exposure", 2)
    assert "times the exposure 2 exceeds float32" in rlbench(*words, code=2)
    assert not (tmp_path / "out" / "walk" / "view.0001.exr").exists()


def test_a_clip_is_not_written_through_a_link(source, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "walk").symlink_to(tmp_path / "elsewhere")
    output = rlbench("import", source, "--format", "oidn", "--out", tmp_path / "out", code=2)
    assert "walk is a link, to" in output
    assert list((tmp_path / "elsewhere").iterdir()) == []


@pytest.mark.parametrize("files", [0, 5])
def test_a_full_disk_is_one_line_and_the_import_resumes(source, tmp_path, monkeypatch, files):
    out, remaining = tmp_path / "out", iter(range(files))

    def fail_after(path) -> None:
        if next(remaining, None) is None:
            raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full_disk:
        full_disk.setattr(paths, "_synchronize", fail_after)
        output = rlbench("import", source, "--format", "oidn", "--out", out, code=2)
    assert "No space left on device" in output
    assert "bytes free, free some space, or choose another folder" in output
    assert [path for path in (out / "walk").iterdir() if path.name.startswith(".")] == []
    assert not (out / "walk" / "clip.toml").exists()
    rlbench("import", source, "--format", "oidn", "--out", out)
    assert verify(out / "walk") == []
