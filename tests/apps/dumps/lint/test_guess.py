"""Guessed layouts of dumps: what is guessed reads the clip from which the dump was written."""

from __future__ import annotations

import shutil

import numpy as np
import OpenEXR
import pytest

from rlbench.apps.dumps.importers.layout import decode_layout, read_layout
from rlbench.apps.dumps.lint.checks import lint_clip
from rlbench.apps.dumps.lint.clip_arrays import import_arrays
from rlbench.apps.dumps.lint.dump_names import list_unclaimed
from rlbench.apps.dumps.lint.guess import format_guess, guess_layout, recognize_layout
from rlbench.apps.dumps.lint.radiance import check_brightness
from rlbench.checks.result import Verdict
from tests.apps.dumps.importers.dumps import (
    WRITERS,
    planes,
    write_blender,
    write_falcor,
    write_file,
    write_own,
    write_unreal,
)
from tests.apps.dumps.lint.broken_fixtures import correct_clip
from tests.apps.dumps.lint.renderers import RENDERERS, SAMPLES, write_renderer


@pytest.fixture(scope="module")
def small():
    return correct_clip(height=48, width=64, frames=3, half=32)


@pytest.fixture(scope="module")
def own(small, tmp_path_factory):
    """A dump of unusual conventions, its guess and the written file."""
    folder = tmp_path_factory.mktemp("own")
    write_own(small, folder / "dump").unlink()
    guess = guess_layout(folder / "dump")
    (folder / "engine.toml").write_text(format_guess(guess))
    return guess, folder


def test_motion_in_another_unit_with_y_up_is_recognised_and_sure(own):
    guess, _ = own
    motion = guess.tables["motion"]
    assert (motion["unit"], motion["y"], motion["points"]) == ("ndc", "up", "to previous")
    assert "sure: (x, -y) in NDC" in guess.reasons["motion"]


def test_accumulated_flipped_and_demodulated_light_is_recognised(own):
    radiance = own[0].tables["radiance"]
    assert (radiance["samples"], radiance["flip"]) == ("accumulated", "vertical")
    assert radiance["demodulated"]


def test_emission_is_added_to_demodulated_light(own):
    guess, folder = own
    assert guess.tables["emission"]["part"] == "emission"
    found = import_arrays(folder / "dump", read_layout(str(folder / "engine.toml")))
    assert check_brightness(found).verdict is Verdict.PASSED


def test_encoded_normals_in_view_space_are_recognised(own):
    normal = own[0].tables["normal"]
    assert (normal["encoded"], normal["space"]) == (True, "view")


def test_the_written_file_imports_what_was_dumped(own, small):
    _, folder = own
    found = import_arrays(folder / "dump", read_layout(str(folder / "engine.toml")))
    # half precision, of the albedo that was dumped
    np.testing.assert_allclose(found.gbuffer["albedo"], small.gbuffer["albedo"], atol=1e-3)
    # pixels; single precision
    np.testing.assert_allclose(found.gbuffer["motion"], small.gbuffer["motion"], atol=1e-3)


SLOW = pytest.mark.slow
UNREAD = {  # what a renderer writes beside the images that are read
    "Arnold": ["A"],
    "RenderMan": ["a", "dPcameradtime.x"],
    "V-Ray": ["A"],
    "Karma": [],
    "Redshift": ["A"],
    "Unreal": ["ActorHitProxyMask.R"],
    "Blender": ["Composite.Combined.B", "Layer.Denoising Normal.X"],
}
LACKS = {
    "RenderMan": {"motion"},
    "Redshift": {"normal"},
    "Unreal": {"albedo"},
}


@pytest.mark.parametrize(
    "name",
    [
        name if name in ("RenderMan", "Unreal", "Blender") else pytest.param(name, marks=SLOW)
        for name in RENDERERS
    ],
)
def test_a_guess_for_a_renderer_imports_without_an_edit(name, small, tmp_path):
    write_renderer(name, small, tmp_path / "dump")
    guess = guess_layout(tmp_path / "dump")
    (tmp_path / "engine.toml").write_text(format_guess(guess))
    layout = read_layout(str(tmp_path / "engine.toml"))
    found = import_arrays(tmp_path / "dump", layout)
    assert set(found.gbuffer) == set(small.gbuffer) - LACKS.get(name, set())
    assert found.pools["path"].shape[:2] == (3, SAMPLES)
    for buffer, image in found.gbuffer.items():
        # half precision, of what was dumped; motion in pixels
        expected = small.gbuffer[buffer]
        if (name, buffer) == ("Unreal", "motion"):  # 1 / 2048 of a share is hidden by an offset
            np.testing.assert_allclose(image, expected, atol=0.02)
        else:
            np.testing.assert_allclose(image, expected, atol=2e-3, rtol=2e-3)
    np.testing.assert_allclose(found.half_a, small.half_a, rtol=1e-6)
    unread = list_unclaimed(tmp_path / "dump", layout)
    assert [line.partition(" (")[0].split(",")[0] for line in unread] == UNREAD[name]


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
            write_file(tmp_path / "dump" / name.format(t), {"": planes(image, "RGB", kind="f4")})
    guess = guess_layout(tmp_path / "dump")
    placeholder = {"separate": "{sample}", "accumulated": "{spp}"}[kind]
    assert guess.tables["radiance"]["files"] == f"frame_{{frame}}.spp{placeholder}.exr"
    assert "%" not in guess.reasons["radiance"]
    found = import_arrays(tmp_path / "dump", decode_layout(guess.tables, "guess"))
    # twice a mean minus the first sample, in single precision
    np.testing.assert_allclose(found.pools["path"], small.pools["path"][:, :2], atol=1e-5)


@pytest.mark.slow
def test_a_guess_for_unreal_passes_the_linter(small, tmp_path):
    write_unreal(small, tmp_path / "dump")
    (tmp_path / "engine.toml").write_text(format_guess(guess_layout(tmp_path / "dump")))
    found = import_arrays(tmp_path / "dump", read_layout(str(tmp_path / "engine.toml")))
    checks = {r.check for r in lint_clip(found) if r.verdict is Verdict.FAILED}
    assert not checks & {"motion", "depth", "normal", "albedo", "orientation"}


@pytest.mark.parametrize(
    "name",
    [
        "nrd-sample",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("falcor", "unreal", "oidn")),
    ],
)
def test_the_dump_of_a_known_engine_is_recognised(small, tmp_path, name):
    WRITERS[name](small, tmp_path / "dump")
    assert recognize_layout(tmp_path / "dump") == name


def test_a_known_engine_with_another_convention_is_not_recognised(small, tmp_path):
    flipped = {**small.gbuffer, "motion": -small.gbuffer["motion"]}
    write_falcor(
        type(small)(small.header, flipped, small.pools, small.half_a, small.half_b), tmp_path
    )
    assert recognize_layout(tmp_path) is None


def test_a_dump_without_a_reference_has_a_layout_without_one(small, tmp_path):
    write_falcor(small, tmp_path)
    for half in "AB":
        shutil.rmtree(tmp_path / f"reference{half}")
    (tmp_path / "engine.toml").write_text(format_guess(guess_layout(tmp_path)))
    layout = read_layout(str(tmp_path / "engine.toml"))
    assert layout.reference.files == ()
    assert layout.radiance.files == "sample{sample}/Mogwai.PathTracer.color.{frame}.exr"


def test_world_normals_win_over_those_in_camera_space(small, tmp_path):
    write_blender(small, tmp_path / "dump")
    for path in (tmp_path / "dump").rglob("*.exr"):
        with OpenEXR.File(str(path), separate_channels=True) as file:
            stored = {name: channel.pixels for name, channel in file.channels().items()}
        camera = {f"ViewLayer.Denoising Normal.{c}": stored["ViewLayer.Normal.X"] for c in "XYZ"}
        composite = {f"Composite.Combined.{c}": stored["ViewLayer.Depth.Z"] for c in "RGB"}
        write_file(path, {"": stored | camera | composite})
    tables = guess_layout(tmp_path / "dump").tables
    assert tables["normal"]["channels"] == [f"ViewLayer.Normal.{c}" for c in "XYZ"]
    assert tables["radiance"]["channels"] == [f"ViewLayer.Combined.{c}" for c in "RGB"]
    assert recognize_layout(tmp_path / "dump") == "blender"


# Alpha


def write_alpha(folder, *, is_straight: bool, sky: float) -> None:
    """A disk that moves before a sky of alpha 0, with partial alpha at its edge."""
    h, w = 48, 64
    y, x = np.mgrid[:h, :w]
    noise = np.random.default_rng(0)
    for frame in range(2):
        distance = np.hypot(x - 30 - frame, y - 24)
        alpha = np.clip(15 - distance, 0, 1)  # one pixel wide
        surface = 0.4 + 0.1 * np.sin(x / 5)
        light = alpha * surface + (1 - alpha) * sky
        light = (
            np.divide(light, alpha, where=alpha > 0, out=np.zeros((h, w))) if is_straight else light
        )
        kinds = {"reference": light} | {
            f"sample{s}": light * noise.uniform(0.5, 1.5, (h, w)) for s in (0, 1)
        }
        for kind, image in kinds.items():
            planes = {c: image.astype(np.float32) for c in "RGB"} | {"A": alpha.astype(np.float32)}
            write_file(folder / kind / f"beauty.{frame}.exr", {"": planes})


@pytest.mark.parametrize(
    ("is_straight", "sky", "found"),
    [(True, 0.0, True), (False, 0.0, False), (False, 0.3, False), (False, 4.0, False)],
)
def test_colours_that_are_not_multiplied_by_alpha_are_recognised(tmp_path, is_straight, sky, found):
    write_alpha(tmp_path / "dump", is_straight=is_straight, sky=sky)
    guess = guess_layout(tmp_path / "dump")
    assert ("alpha" in guess.tables["reference"], "alpha" in guess.tables["radiance"]) == (
        found,
    ) * 2
    assert ("have colour at alpha 0, which is kept" in guess.reasons["reference"]) == (sky > 0)
    (tmp_path / "guess.toml").write_text(format_guess(guess))
    arrays = import_arrays(tmp_path / "dump", read_layout(str(tmp_path / "guess.toml")))
    write_alpha(tmp_path / "expected", is_straight=False, sky=sky)
    (tmp_path / "plain.toml").write_text(
        '[radiance]\nfiles = "sample{sample}/*{frame}.exr"\n'
        '[reference]\nfiles = "reference/*{frame}.exr"'
    )
    expected = import_arrays(tmp_path / "expected", read_layout(str(tmp_path / "plain.toml")))
    np.testing.assert_allclose(arrays.half_a, expected.half_a, rtol=1e-5, atol=1e-7)
