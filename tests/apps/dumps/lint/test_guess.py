"""Guessed layouts of dumps: what is guessed reads the clip from which the dump was written."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rlbench.apps.dumps.importers.layout import Layout, decode_layout, read_layout
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, import_arrays
from rlbench.apps.dumps.lint.dump_names import list_unclaimed
from rlbench.apps.dumps.lint.guess import Guess, format_guess, guess_layout, recognize_layout
from rlbench.apps.dumps.lint.radiance import check_brightness
from rlbench.checks.result import Verdict
from tests.apps.dumps.exr_files import read_planes, write_file, write_image
from tests.apps.dumps.importers.dumps import (
    WRITERS,
    floats,
    write_blender,
    write_falcor,
    write_layered,
    write_own,
)
from tests.apps.dumps.lint.broken_fixtures import correct_clip


@pytest.fixture(scope="module")
def small():
    return correct_clip(height=48, width=64, frames=3, half=32)


def read_back(source: Path) -> tuple[Guess, Layout, ClipArrays]:
    """A guess, the layout in its file, and what that reads."""
    guess = guess_layout(source)
    file = source.parent / f"{source.name}.toml"
    file.write_text(format_guess(guess))
    layout = read_layout(str(file))
    return guess, layout, import_arrays(source, layout)


@pytest.fixture(scope="module")
def own(small, tmp_path_factory):
    """A dump of unusual conventions, its guess and what the written file reads."""
    folder = tmp_path_factory.mktemp("own")
    write_own(small, folder / "dump").unlink()
    guess, _, found = read_back(folder / "dump")
    return guess, found


@pytest.mark.parametrize(
    ("table", "keys"),
    [
        ("motion", {"unit": "ndc", "y": "up", "points": "to previous"}),
        ("radiance", {"samples": "accumulated", "flip": "vertical", "demodulated": True}),
        ("emission", {"part": "emission"}),
        ("normal", {"encoded": True, "space": "view"}),
    ],
)
def test_unusual_conventions_are_recognised(own, table, keys):
    assert keys.items() <= own[0].tables[table].items()


def test_the_written_file_says_what_is_sure_and_imports_what_was_dumped(own, small):
    guess, found = own
    assert "sure: (x, -y) in NDC" in guess.reasons["motion"]
    assert check_brightness(found).verdict is Verdict.PASSED  # with emission
    # half precision, of the albedo that was dumped; pixels, in single precision
    for name in ("albedo", "motion"):
        np.testing.assert_allclose(found.gbuffer[name], small.gbuffer[name], atol=1e-3)


SLOW = pytest.mark.slow
RENDERERS = {  # what one writes beside the images that are read, and the buffers that it lacks
    "renderman": (["a", "dPcameradtime.x"], {"motion"}),
    "unreal": ([], set()),
}


@pytest.mark.parametrize("name", RENDERERS)
def test_a_guess_for_a_renderer_imports_without_an_edit(name, small, tmp_path):
    write_layered(name, small, tmp_path / "dump")
    _, layout, found = read_back(tmp_path / "dump")
    unread, lacks = RENDERERS[name]
    assert set(found.gbuffer) == set(small.gbuffer) - lacks
    assert found.pools["path"].shape[:2] == (3, 2)  # of eight samples
    for buffer, image in found.gbuffer.items():
        # half precision, of what was dumped; motion in pixels
        np.testing.assert_allclose(image, small.gbuffer[buffer], atol=2e-3, rtol=2e-3)
    np.testing.assert_allclose(found.half_a, small.half_a, rtol=1e-6)
    lines = list_unclaimed(tmp_path / "dump", layout)
    assert [line.partition(" (")[0].split(",")[0] for line in lines] == unread


@pytest.mark.parametrize("kind", ["separate", "accumulated"])
def test_images_that_count_spp_are_samples_or_their_means_as_their_noise_shows(
    kind, small, tmp_path
):
    for t in range(len(small)):
        first, second = small.pools["path"][t, :2]
        images = {
            "frame_{:04d}.spp1.exr": first,
            "frame_{:04d}.spp2.exr": second if kind == "separate" else (first + second) / 2,
            "reference_{:04d}.exr": small.half_a[t],
        }
        for name, image in images.items():
            write_file(tmp_path / "dump" / name.format(t), {"": floats(image, "RGB")})
    guess = guess_layout(tmp_path / "dump")
    placeholder = {"separate": "{sample}", "accumulated": "{spp}"}[kind]
    assert guess.tables["radiance"]["files"] == f"frame_{{frame}}.spp{placeholder}.exr"
    assert "%" not in guess.reasons["radiance"]
    found = import_arrays(tmp_path / "dump", decode_layout(guess.tables, "guess"))
    # twice a mean minus the first sample, in single precision
    np.testing.assert_allclose(found.pools["path"], small.pools["path"][:, :2], atol=1e-5)


@pytest.mark.parametrize(
    "name", ["nrd-sample", *(pytest.param(n, marks=SLOW) for n in ("falcor", "unreal"))]
)
def test_the_dump_of_a_known_engine_is_recognised(small, tmp_path, name):
    WRITERS[name](small, tmp_path / "dump")
    assert recognize_layout(tmp_path / "dump") == name


def test_a_known_engine_with_another_convention_is_not_recognised(small, tmp_path):
    flipped = {**small.gbuffer, "motion": -small.gbuffer["motion"]}
    write_falcor(replace(small, gbuffer=flipped), tmp_path)
    assert recognize_layout(tmp_path) is None


def test_a_dump_without_a_reference_has_a_layout_without_one(small, tmp_path):
    write_falcor(small, tmp_path / "dump")
    for half in "AB":
        shutil.rmtree(tmp_path / "dump" / f"reference{half}")
    _, layout, _ = read_back(tmp_path / "dump")
    assert layout.reference.files == ()
    assert layout.radiance.files == "sample{sample}/Mogwai.PathTracer.color.{frame}.exr"


def test_world_normals_win_over_those_in_camera_space(small, tmp_path):
    write_blender(small, tmp_path / "dump")
    for path in (tmp_path / "dump").rglob("*.exr"):
        stored = read_planes(path)
        camera = {f"ViewLayer.Denoising Normal.{c}": stored["ViewLayer.Normal.X"] for c in "XYZ"}
        composite = {f"Composite.Combined.{c}": stored["ViewLayer.Depth.Z"] for c in "RGB"}
        write_file(path, {"": stored | camera | composite})
    tables = guess_layout(tmp_path / "dump").tables
    assert tables["normal"]["channels"] == [f"ViewLayer.Normal.{c}" for c in "XYZ"]
    assert tables["radiance"]["channels"] == [f"ViewLayer.Combined.{c}" for c in "RGB"]
    assert recognize_layout(tmp_path / "dump") == "blender"


# Alpha


def write_alpha(folder: Path, *, is_straight: bool, sky: float) -> Path:
    """A disk that moves before a sky of alpha 0, with partial alpha at its edge."""
    h, w = 48, 64
    y, x = np.mgrid[:h, :w]
    noise = np.random.default_rng(0)
    for frame in range(2):
        distance = np.hypot(x - 30 - frame, y - 24)
        alpha = np.clip(15 - distance, 0, 1)  # one pixel wide
        light = alpha * (0.4 + 0.1 * np.sin(x / 5)) + (1 - alpha) * sky
        if is_straight:
            light = np.divide(light, alpha, where=alpha > 0, out=np.zeros((h, w)))
        kinds = {"reference": light}
        kinds |= {f"sample{s}": light * noise.uniform(0.5, 1.5, (h, w)) for s in (0, 1)}
        for kind, image in kinds.items():
            stored = np.stack([image, image, image, alpha], -1).astype(np.float32)
            write_image(folder / kind / f"beauty.{frame}.exr", stored, "RGBA")
    return folder


PLAIN = {"radiance": "sample{sample}/*{frame}.exr", "reference": "reference/*{frame}.exr"}


@pytest.mark.parametrize(
    ("is_straight", "sky", "found"),
    [(True, 0.0, True), (False, 0.0, False), (False, 0.3, False), (False, 4.0, False)],
)
def test_colours_that_are_not_multiplied_by_alpha_are_recognised(tmp_path, is_straight, sky, found):
    dump = write_alpha(tmp_path / "dump", is_straight=is_straight, sky=sky)
    guess, _, arrays = read_back(dump)
    assert ["alpha" in guess.tables[name] for name in PLAIN] == [found, found]
    assert ("have colour at alpha 0, which is kept" in guess.reasons["reference"]) == (sky > 0)
    plain = write_alpha(tmp_path / "plain", is_straight=False, sky=sky)
    layout = decode_layout({name: {"files": files} for name, files in PLAIN.items()}, "plain")
    expected = import_arrays(plain, layout)
    np.testing.assert_allclose(arrays.half_a, expected.half_a, rtol=1e-5, atol=1e-7)
