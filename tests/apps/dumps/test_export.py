"""Exported clips: what importers read back, without references too, and what oidnDenoise makes."""

from __future__ import annotations

import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch

from rlbench import registry
from rlbench.apps.dumps.export import FORMATS, export_clip
from rlbench.apps.dumps.foreign_images import Claim, find_foreign_images, score_foreign_images
from rlbench.apps.dumps.importers import formats, writer
from rlbench.apps.dumps.importers.layout import ready_layouts
from rlbench.apps.dumps.lint.checks import lint_clip
from rlbench.apps.dumps.lint.clip_arrays import read_clip_arrays
from rlbench.benchmark import results as table
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.runner import measure
from rlbench.benchmark.scoring import NO_REFERENCE
from rlbench.checks.result import Verdict
from rlbench.clips.header import ClipError, read_header
from rlbench.clips.pfm import read_pfm
from rlbench.clips.stored import open_clip, verify
from rlbench.run import run_clip
from rlbench.training.dataset import find_own_clips
from tests.apps.dumps.lint.broken_fixtures import store
from tests.benchmark.test_runner import run_plan
from tests.cli.runner import rlbench
from tests.conftest import write_noise

HALF = {"rtol": 2e-3, "atol": 2e-3}  # a clip stores half floats
LAYOUTS = {"nrd": "nrd-sample", "exr": "blender"}  # of rlbench import, which the tests check
ROUNDING_DB = 1e-3  # sums of floats in another order; no sample is so bright that a row dims it


@pytest.fixture
def clip(tmp_path) -> Path:
    return write_noise(tmp_path / "noise", h=32, w=48, exposure=0.25)


@pytest.mark.parametrize("name", LAYOUTS)
def test_an_export_with_references_imports_as_the_clip_that_it_was(short, tmp_path, name):
    scene = store(short, tmp_path / "scene")
    export_clip(scene, tmp_path / "out", name, spp=1, with_reference=True)
    (sequence,) = formats.find_sequences(tmp_path / "out", LAYOUTS[name])
    header = writer.clip_header(sequence, None)
    writer.write_clip(sequence, header, tmp_path / "again")
    before, after = open_clip(scene, max_samples=1), open_clip(tmp_path / "again", max_samples=1)
    exposure = before.header.exposure
    for old, new in zip(before, after, strict=True):
        ones = torch.ones_like(old.pool.empty().counts)
        samples = [each.pool.read(each.pool.empty(), ones) for each in (old, new)]
        torch.testing.assert_close(samples[0] / exposure, samples[1], **HALF)
        half = old.reference.half_b / exposure
        torch.testing.assert_close(half, new.reference.half_b, rtol=1e-6, atol=0)
        for buffer, values in old.gbuffer.buffers.items():
            torch.testing.assert_close(values, new.gbuffer.buffers[buffer], **HALF)


def test_radiance_is_the_mean_of_the_samples_that_a_uniform_method_buys(clip, tmp_path):
    export_clip(clip, tmp_path / "out", "oidn", spp=2, seed=3)
    mean = registry.load_method("mean", torch.device("cpu"))
    for result in run_clip(mean, open_clip(clip, seed=3), 2.0):
        color = read_pfm(tmp_path / "out" / f"color.{result.frame.index:04}.pfm")
        exposed = result.image[0].movedim(0, -1).numpy()
        np.testing.assert_allclose(color * 0.25, exposed, rtol=1e-5)


def oidn_denoise() -> Path | None:
    """Intel's command-line example, which is in the wheel of pyoidn."""
    spec = find_spec("pyoidn")
    file = Path(str(spec and spec.origin)).parent / "oidn" / "bin" / "oidnDenoise"
    return file if file.is_file() else None


@pytest.mark.skipif(oidn_denoise() is None, reason="no oidnDenoise: pip install pyoidn")
@pytest.mark.parametrize("row", ["oidn", "oidn-intel"])
def test_intels_own_program_scores_as_our_row_of_its_weights(clip, tmp_path, row):
    images = tmp_path / "images"
    images.mkdir()
    export_clip(clip, tmp_path / "out", "oidn")
    for index in range(3):
        denoise(tmp_path / "out", f"{index:04}", images)
    found = find_foreign_images(images, [StoredSource(clip)])
    score_foreign_images(Claim("theirs", 1.0), found, tmp_path / "r")
    measure(run_plan(clip, row), tmp_path / "r", times="none")
    rows = table.read(tmp_path / "r").query("metric == 'psnr' and frame >= 0")
    ours, theirs = (rows[rows["method"] == name].set_index("frame") for name in (row, "theirs"))
    assert ours["value"].to_numpy() == pytest.approx(theirs["value"].to_numpy(), abs=ROUNDING_DB)


def denoise(folder: Path, frame: str, out: Path) -> None:
    """The command that `export.toml` names, on one frame."""
    (line,) = [note for note in FORMATS["oidn"].notes if note.startswith("run: ")]
    words = line.removeprefix("run: ").replace("0000", frame).split()
    words = [word.replace("out/", f"{out}/") for word in words]
    subprocess.run([str(oidn_denoise()), *words[1:]], cwd=folder, check=True, capture_output=True)


def test_a_killed_export_resumes_and_another_one_is_refused(clip, tmp_path):
    out = tmp_path / "out"
    export_clip(clip, out, "exr")
    before = {file.name: file.stat().st_mtime_ns for file in out.iterdir()}
    (out / "0001.exr").unlink()
    export_clip(clip, out, "exr")
    after = {file.name: file.stat().st_mtime_ns for file in out.iterdir()}
    assert {name for name in before if before[name] != after[name]} == {"0001.exr"}
    with pytest.raises(ClipError, match="another export"):
        export_clip(clip, out, "exr", spp=2)


def test_buffers_that_a_clip_lacks_are_left_out_and_named(tmp_path):
    clip = write_noise(tmp_path / "noise", buffers=("albedo",))
    notes = export_clip(clip, tmp_path / "out", "nrd")
    assert any(note.startswith("depth is left out") for note in notes)
    assert not list((tmp_path / "out").glob("IN_VIEWZ*"))


# Clips without references, of all frames or some: they import and run, and are scored in part


ALL, LAST = (0, 1, 2), (2,)


@pytest.fixture(scope="module", params=[ALL, LAST], ids=["no frame", "some frames"])
def unscored(request, tmp_path_factory) -> tuple[Path, tuple[int, ...]]:
    """A clip that was imported from a dump without these references."""
    root = tmp_path_factory.mktemp("clip")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(root / "cache"))
        dump = export_clip_without(request.param, root)
        layout = ready_layouts()["blender"].read_text()
        text = layout.replace("[reference]\n", "[reference]\noptional = true\n")
        (root / "mine.toml").write_text(text)
        words = ("import", dump, "--out", root / "clips", "--layout")
        assert "optional = true" in rlbench(*words, "blender", code=2)
        assert "limitation no reference" in rlbench(*words, root / "mine.toml")
    return root / "clips" / "dump", request.param


def export_clip_without(missing: tuple[int, ...], root: Path) -> Path:
    export_clip(write_noise(root / "noise"), root / "dump", "exr", with_reference=True)
    for frame in missing:
        for half in "AB":
            (root / "dump" / f"reference{half}" / f"reference.{frame:04}.exr").unlink()
    return root / "dump"


def test_the_reference_of_such_frames_is_nan_and_the_clip_is_valid(unscored):
    folder, missing = unscored
    assert verify(folder) == []
    lacking = [np.isnan(f.reference.mean.numpy()).all() for f in open_clip(folder)]
    assert [i for i, is_nan in enumerate(lacking) if is_nan] == list(missing)


def test_nan_in_a_clip_that_does_not_declare_it_is_damage(unscored, tmp_path):
    folder = shutil.copytree(unscored[0], tmp_path / "clip")
    text = (folder / "clip.toml").read_text().replace('"no reference"', '"linear"')
    (folder / "clip.toml").write_text(text)
    assert "not finite" in verify(folder)[0]


def test_frames_are_scored_where_that_is_possible(unscored, tmp_path):
    folder, missing = unscored
    words = ("--clips", folder, "--spp", 1, "--times", "none", "--keep-images")
    rlbench("run", "-m", "mean,eaw", *words, "--out", tmp_path / "r")
    rows = table.read(tmp_path / "r").query("method == 'mean' and frame >= 0").set_index("metric")
    psnr = rows.loc["psnr"].set_index("frame")
    assert set(psnr.index[psnr["value"].isna()]) == set(missing)
    assert set(psnr.loc[list(missing), "note"]) == {NO_REFERENCE}
    assert rows.loc["nonfinite", "value"].tolist() == [0, 0, 0]
    assert rows.loc["at_cap", "value"].notna().all()
    rlbench("view", tmp_path / "r", "--clips", folder, "--out", tmp_path / "page.html")
    rlbench("evaluate", tmp_path / "r", "--metrics", "image_flicker,psnr", "--clips", folder)
    flicker = table.read(tmp_path / "r" / "evaluated").query("metric == 'image_flicker'")
    assert flicker["value"].notna().all()
    rlbench("images", "-m", "mean", "--clips", folder, "--frame", 2, "--out", tmp_path / "images")
    if missing == LAST:
        rlbench("report", "summary", "--results", tmp_path / "r", "--out", tmp_path / "report")
        assert "| mean |" in (tmp_path / "report" / "summary.md").read_text()


def test_what_compares_with_references_says_that_there_are_none(unscored):
    folder, _ = unscored
    assert "no reference" in read_header(folder).limitations
    with pytest.raises(ClipError, match="reference"):
        find_own_clips([folder])
    results = {each.check: each for each in lint_clip(read_clip_arrays(folder))}
    assert results["brightness"].verdict is Verdict.WARNING
    assert "no reference" in results["brightness"].found
