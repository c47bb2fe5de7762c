"""Clips without references, of all frames or some: they import and run, and are scored in part."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from rlbench.apps.dumps.export import export_clip
from rlbench.apps.dumps.importers.layout import ready_layouts
from rlbench.apps.dumps.lint.checks import lint_clip
from rlbench.apps.dumps.lint.clip_arrays import read_clip_arrays
from rlbench.benchmark import results as table
from rlbench.benchmark.scoring import NO_REFERENCE
from rlbench.checks.result import Verdict
from rlbench.clips.header import ClipError, read_header
from rlbench.clips.stored import open_clip, verify
from rlbench.training.dataset import find_own_clips
from tests.cli.runner import rlbench
from tests.conftest import write_noise

ALL, LAST = (0, 1, 2), (2,)


@pytest.fixture(scope="module", params=[ALL, LAST], ids=["no frame", "some frames"])
def clip(request, tmp_path_factory) -> tuple[Path, tuple[int, ...]]:
    """A clip that was imported from a dump without these references."""
    root = tmp_path_factory.mktemp("clip")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(root / "cache"))
        dump = write_dump(root, request.param)
        layout = ready_layouts()["blender"].read_text()
        text = layout.replace("[reference]\n", "[reference]\noptional = true\n")
        (root / "mine.toml").write_text(text)
        words = ("--layout", root / "mine.toml", "--out", root / "clips")
        assert "limitation no reference" in rlbench("import", dump, *words)
    return root / "clips" / "dump", request.param


def write_dump(root: Path, missing: tuple[int, ...]) -> Path:
    export_clip(write_noise(root / "noise"), root / "dump", "exr", with_reference=True)
    for frame in missing:
        for half in "AB":
            (root / "dump" / f"reference{half}" / f"reference.{frame:04}.exr").unlink()
    return root / "dump"


def test_a_layout_must_say_that_references_are_optional(tmp_path):
    dump = write_dump(tmp_path, LAST)
    words = ("import", dump, "--layout", "blender", "--out", tmp_path / "clips")
    assert "optional = true" in rlbench(*words, code=2)


def test_the_reference_of_such_frames_is_nan_and_the_clip_is_valid(clip):
    folder, missing = clip
    assert verify(folder) == []
    lacking = [np.isnan(f.reference.mean.numpy()).all() for f in open_clip(folder)]
    assert [i for i, is_nan in enumerate(lacking) if is_nan] == list(missing)


def test_nan_in_a_clip_that_does_not_declare_it_is_damage(clip, tmp_path):
    folder = shutil.copytree(clip[0], tmp_path / "clip")
    text = (folder / "clip.toml").read_text().replace('"no reference"', '"linear"')
    (folder / "clip.toml").write_text(text)
    assert "not finite" in verify(folder)[0]


def test_frames_are_scored_where_that_is_possible(clip, tmp_path):
    folder, missing = clip
    words = ("--clips", folder, "--spp", 1, "--times", "none", "--keep-images")
    rlbench("run", "-m", "mean,eaw", *words, "--out", tmp_path / "r")
    rows = table.read(tmp_path / "r").query("method == 'mean' and frame >= 0").set_index("metric")
    psnr = rows.loc["psnr"].set_index("frame")
    assert set(psnr.index[psnr["value"].isna()]) == set(missing)
    assert set(psnr.loc[list(missing), "note"]) == {NO_REFERENCE}
    assert rows.loc["nonfinite", "value"].tolist() == [0, 0, 0]
    assert rows.loc["at_cap", "value"].notna().all()
    rlbench("view", tmp_path / "r", "--clips", folder, "--out", tmp_path / "page.html")
    assert (tmp_path / "page.html").is_file()
    words = ("--metrics", "image_flicker,psnr", "--clips", folder)
    rlbench("evaluate", tmp_path / "r", *words)
    flicker = table.read(tmp_path / "r" / "evaluated").query("metric == 'image_flicker'")
    assert flicker["value"].notna().all()
    rlbench("images", "-m", "mean", "--clips", folder, "--frame", 2, "--out", tmp_path / "images")
    if missing == LAST:
        rlbench("report", "summary", "--results", tmp_path / "r", "--out", tmp_path / "report")
        assert "| mean |" in (tmp_path / "report" / "summary.md").read_text()


def test_what_compares_with_references_says_that_there_are_none(clip):
    folder, _ = clip
    assert "no reference" in read_header(folder).limitations
    with pytest.raises(ClipError, match="reference"):
        find_own_clips([folder])
    results = {each.check: each for each in lint_clip(read_clip_arrays(folder))}
    assert results["brightness"].verdict is Verdict.WARNING
    assert "no reference" in results["brightness"].found
