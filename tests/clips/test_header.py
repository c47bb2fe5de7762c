"""clip.toml: round trip, checks, and names that digests must keep."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rlbench.apps.render.jobs.job import Job
from rlbench.clips import ClipError, read_header, verify, write_frame, write_header
from rlbench.clips.header import BUFFER_CHANNELS
from rlbench.clips.presets import Preset
from tests.apps.render.small_scenes import room
from tests.clips.clip_folders import FRAMES, HEADER, edit

# Round trip


def test_a_header_comes_back(tmp_path):
    header = replace(HEADER, licence='CC0 "1.0"\n\\ ü 🙂', sample_ms=12.5, static=True, fps=1e-5)
    header = replace(header, light_changes=(1,), missing_files=("models/chair.obj", "wood.png"))
    for each in (header, replace(HEADER, sample_ms=2.0, cuts=(1,))):
        write_header(tmp_path, each)
        assert read_header(tmp_path) == each
        has_missing = "missing_files" in (tmp_path / "clip.toml").read_text("utf-8")
        assert has_missing == bool(each.missing_files)


@given(text=st.text(st.characters(exclude_categories=["Cs"])))
def test_any_text_survives_in_toml(text, tmp_path_factory):
    folder = tmp_path_factory.mktemp("toml")
    write_header(folder, replace(HEADER, licence=text))
    assert tomllib.loads((folder / "clip.toml").read_text("utf-8"))["licence"] == text


def test_keys_that_the_format_does_not_have_are_ignored_and_integers_read_as_floats(folder):
    edit(folder, "version = 2", "version = 2\nartist = 'someone'")
    edit(folder, "exposure = 0.5", "exposure = 2")
    header = read_header(folder)
    assert (header.name, header.exposure) == (HEADER.name, 2.0)
    assert isinstance(header.exposure, float)
    assert math.isnan(header.sample_ms)  # it is not known


# Invalid headers


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"cuts": (0,)}, "cuts"),
        ({"cuts": (FRAMES,)}, "cuts"),
        ({"cuts": (1,), "static": True}, "static"),
        ({"light_changes": (0,)}, "light_changes"),
        ({"light_changes": (FRAMES,)}, "light_changes"),
        ({"height": 30_000, "width": 30_000}, "900000000 pixels"),
        ({"buffers": ("depth", "depth")}, "depth twice"),
        ({"pools": ("path", "path")}, "path twice"),
        ({"limitations": ("colour",)}, "colour; .* has: halves"),
        ({"buffers": ("depth", "colour")}, "colour; .* has: albedo"),
    ],
)
def test_a_contradiction_is_an_error(wrong, message):
    with pytest.raises(ClipError, match=message):
        replace(HEADER, **wrong)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("exposure = 0.5", "exposure = -1", r"exposure is -1\.0, expected 1e-12 .*; correct clip"),
        ("exposure = 0.5", "exposure = 1e308", "exposure is 1e[+]308, expected 1e-12 to 1e[+]12"),
        ("exposure = 0.5", "exposure = nan", "exposure is nan, expected 1e-12"),
        ("sample_ms = nan", "sample_ms = -1.0", "sample_ms is -1.0, expected 0 to .*, or nan"),
        ("pool_spp = 4", "pool_spp = 2147483648", "pool_spp is 2147483648, expected 1 to 1024"),
        ("seed = 0", "seed = -1", "seed is -1, expected 0 to"),
        ("height = 5", "height = 1000000", "height is 1000000, expected 1 to 65536"),
        ("    32,", "    -32,", "reference_spp lists -32, expected 0 to 2147483647"),
        ("noise_ceiling_db = []", "noise_ceiling_db = [1e9, 3.0]", "noise_ceiling_db lists 1000"),
        ("pools_ms = []", "pools_ms = [1.0, 2.0]", "pools_ms lists 2 pools, the clip has 1"),
        ('"path"', '"../../path"', "pools has '../../path', expected letters, digits"),
        ('"street/mini"', '"../street"', "name has '[.][.]', expected letters, digits"),
        ('"street/mini"', '"/street"', "name has '', expected letters, digits"),
        ('scene = "street"', 'scene = "a\\nb"', "scene has 'a.*b', expected letters, digits"),
        # of another type
        ('name = "street/mini"', "name = 3", r"Expected `str`, got `int` - at `\$\.name`.*is 3;"),
        ("static = false", "static = 0", r"at `\$\.static`, which is 0;"),
        ("cuts = []", 'cuts = ["1"]', r"at `\$\.cuts\[0\]`, which is \['1'\];"),
        ("frames = 2", "frames = true", r"at `\$\.frames`, which is True;"),
    ],
)
def test_a_value_out_of_range_is_refused_with_what_is_allowed(folder, old, new, message):
    edit(folder, old, new)
    with pytest.raises(ClipError, match=message):
        read_header(folder)


# Names that digests and keys of clips hold


def test_digests_name_buffers_and_limitations_as_they_always_did():
    header = replace(HEADER, buffers=("albedo", "depth_psr"), limitations=("depth_psr",))
    fields = header.digest_fields("path")
    assert (fields["version"], fields["pools"]) == (1, ("path",))
    assert fields["buffers"] == ("albedo", "depth_behind")
    assert fields["lacks"] == ("depth_behind",)


def test_a_clip_names_its_channels_as_the_header_does(tmp_path):
    rng = np.random.default_rng(0)
    gbuffer = {name: rng.random((8, 8, n)) for name, n in BUFFER_CHANNELS.items()}
    image = rng.random((8, 8, 3))
    write_frame(tmp_path, 0, gbuffer, {"path": np.stack([image, image])}, image, image)
    header = replace(HEADER, height=8, width=8, frames=1, pool_spp=2, reference_spp=(1,))
    write_header(tmp_path, replace(header, buffers=tuple(BUFFER_CHANNELS)))
    assert verify(tmp_path) == []
    assert b"depth_psr.Z" in (tmp_path / "view.0000.exr").read_bytes()


def test_the_key_of_a_rendered_clip_names_its_buffers_as_it_always_did(tmp_path):
    plan = Preset("test", "tests", (8, 8), frames=2, reference_spp=2)
    plan = plan.with_buffers(("object", "depth_psr"))
    key = Job("room", room(), plan, tmp_path).content_key
    assert key.endswith("with object depth_behind\n")
