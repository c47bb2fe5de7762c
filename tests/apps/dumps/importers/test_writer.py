"""`rlbench import`: writing and resuming clips, and measuring a method on an imported clip."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rlbench.apps.dumps.importers import formats, writer
from rlbench.benchmark import results
from rlbench.clips.header import ClipError, read_header
from rlbench.clips.stored import open_clip, verify
from rlbench.system import paths
from tests.apps.dumps.exr_files import write_image
from tests.apps.dumps.importers.sources import radiance, write_oidn, write_rl_path_tracing
from tests.cli.runner import rlbench


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
