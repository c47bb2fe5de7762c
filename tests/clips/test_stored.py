"""Clip folders: round trip, decoding on demand, sample order, and messages about broken clips."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from rlbench.clips import decode_cache
from rlbench.clips.exr import write_exr
from rlbench.clips.frame_files import has_frame, write_frame
from rlbench.clips.header import ClipError, write_header
from rlbench.clips.stored import find_all_clips, open_clip, sample_order, verify
from rlbench.system import paths
from tests.clips.clip_folders import (
    FRAMES,
    HEADER,
    STORED,
    H,
    W,
    content,
    edit,
    touch_up,
    write_clip,
)
from tests.conftest import write_noise


def decoded_files() -> set[str]:
    """The files in the decode cache, as kind/name.frame."""
    return {"/".join(p.parts[-2:])[: -len(".npy")] for p in paths.decoded_folder().rglob("*.npy")}


# Round trip


def test_view_buffers_come_back_at_their_precision_and_references_as_exposed_floats(folder):
    frame, written = open_clip(folder).frame(1), content(1)
    halves = {"a": frame.reference.half_a, "b": frame.reference.half_b}
    for name, image in (frame.gbuffer.buffers | halves).items():
        precision = np.float16 if name in ("albedo", "normal") else np.float32
        expected = written[name].astype(precision).astype(np.float32)
        expected *= np.float32(0.5 if name in halves else 1)
        np.testing.assert_array_equal(image[0].permute(1, 2, 0).numpy(), expected)


def test_the_pool_comes_back_as_exposed_halves_in_some_order(folder):
    samples = open_clip(folder).frame(0).pool.radiance[0].permute(0, 2, 3, 1).numpy()
    written = content(0)["pool"].astype(np.float16).astype(np.float32) * np.float32(0.5)
    assert {image.tobytes() for image in samples} == {image.tobytes() for image in written}


def test_a_firefly_beyond_half_precision_is_not_clipped(tmp_path):
    images = content(0)
    images["pool"][2, 1, 1] = 3e6
    gbuffer = {"depth": images["depth"]}
    write_frame(tmp_path, 0, gbuffer, {"path": images["pool"]}, images["a"], images["b"])
    write_header(tmp_path, replace(HEADER, frames=1, reference_spp=(1,), buffers=("depth",)))
    assert open_clip(tmp_path, inputs=frozenset()).frame(0).pool.radiance.max() == 1.5e6


def test_other_readers_find_the_channels_of_the_format(folder):
    with OpenEXR.File(str(folder / "pool.path.0001.exr"), separate_channels=True) as file:
        channels = file.channels()
        assert set(channels) == {f"s{s}.{c}" for s in range(STORED) for c in "RGB"}
        assert channels["s2.G"].pixels.dtype == np.float16
        np.testing.assert_array_equal(
            channels["s2.G"].pixels, content(1)["pool"][2, :, :, 1].astype(np.float16)
        )


def test_a_static_clip_has_no_motion(tmp_path):
    still = replace(HEADER, static=True, buffers=("albedo", "normal", "depth"))
    assert open_clip(write_clip(tmp_path, still)).frame(0).gbuffer.motion is None


def test_a_window_is_the_same_pixels_of_the_frame(folder):
    clip = open_clip(folder)
    rows, columns = slice(1, 4), slice(2, 7)
    window, frame = clip.frame(1, (rows, columns)), clip.frame(1)
    assert torch.equal(window.pool.radiance, frame.pool.radiance[..., rows, columns])


def test_a_frame_exists_when_all_of_its_files_exist(folder):
    assert has_frame(folder, 1)
    (folder / "referenceB.0001.exr").unlink()
    assert not has_frame(folder, 1)


# Decoding on demand


def test_only_needed_buffers_and_slots_are_decoded(folder, monkeypatch):
    opened, read = [], decode_cache.read_channels
    monkeypatch.setattr(
        decode_cache,
        "read_channels",
        lambda path, *rest: opened.append(path.name) or read(path, *rest),
    )
    clip = open_clip(folder, inputs=frozenset({"depth"}), max_samples=1)
    assert decoded_files() == set()
    clip.frame(1)
    first = sample_order(0, HEADER.name, 1, STORED)[0][0]
    assert decoded_files() == {"view/depth.0001", f"pool.path/s{first}.0001"}
    open_clip(folder, inputs=frozenset({"depth"}), max_samples=2).frame(1)
    assert opened.count("view.0001.exr") == 1
    assert opened.count("pool.path.0001.exr") == 2  # the second slot was new


def test_half_references_are_decoded_when_they_are_first_used(folder):
    frame = open_clip(folder, inputs=frozenset(), max_samples=1).frame(1)
    assert not [name for name in decoded_files() if name.startswith("reference")]
    assert frame.reference.half_b is frame.reference.half_b
    assert [n for n in decoded_files() if n.startswith("reference")] == ["referenceB/rgb.0001"]
    assert frame.reference.mean.isfinite().all()
    assert "referenceA/rgb.0001" in decoded_files()


# The sample order


def test_few_samples_are_the_first_of_many_and_many_are_those_stored(folder):
    clips = [open_clip(folder, max_samples=s) for s in (2, 99)]
    assert [clip.max_samples for clip in clips] == [2, STORED]
    few, many = (clip.frame(0).pool for clip in clips)
    assert torch.equal(few.radiance, many.radiance[:, :2])
    assert (few.max_samples, many.max_samples) == (2, STORED)


@given(seed=st.integers(0, 2**40), index=st.integers(0, 10**6), stored=st.integers(1, 64))
def test_every_stored_sample_is_drawn_once(seed, index, stored):
    assert sorted(sample_order(seed, "clip", index, stored)[0]) == list(range(stored))


@pytest.mark.parametrize("other", [(1, "clip", 0), (0, "other", 0), (0, "clip", 1)])
def test_seed_name_and_frame_each_change_order_and_rounding_seed(other):
    order, rounding_seed = sample_order(0, "clip", 0, 64)
    other_order, other_seed = sample_order(*other, 64)
    assert (order != other_order, rounding_seed != other_seed) == (True, True)


def test_each_sample_is_equally_likely_to_be_drawn_first():
    draws = 4000
    first = np.bincount([sample_order(s, "c", 0, 8)[0][0] for s in range(draws)], minlength=8)
    error = math.sqrt(draws / 8 * 7 / 8)
    assert np.abs(first - draws / 8).max() < 4 * error  # 4 standard errors of a binomial


# Broken clips: each message names the file and what to do


def _cut(path: Path, share: float) -> None:
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])


WIDE = np.zeros((H, W + 1), np.float32)

BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "unfinished": (lambda f: (f / "clip.toml").unlink(), r"unfinished.*clip\.toml.*rlbench render"),
    "not toml": (
        lambda f: (f / "clip.toml").write_text("name ="),
        r"clip\.toml is not TOML.*render",
    ),
    "new version": (
        lambda f: edit(f, "version = 2", "version = 3"),
        r"clip\.toml has format version 3.*reads 2.*update rlbench",
    ),
    "no key": (
        lambda f: edit(f, "height", "hight"),
        r"clip\.toml: .*missing required field `height`.*correct the file",
    ),
    "contradiction": (lambda f: edit(f, "frames = 2", "frames = 3"), "lists 2 frames.* has 3"),
    "missing pool": (
        lambda f: (f / "pool.path.0000.exr").unlink(),
        r"pool\.path\.0000\.exr is missing.*rlbench render",
    ),
    "wrong size": (
        lambda f: write_exr(f / "referenceA.0001.exr", dict.fromkeys("RGB", WIDE)),
        r"referenceA\.0001\.exr is 8 x 5 pixels, clip\.toml says 7 x 5.*render",
    ),
    "nan": (
        lambda f: touch_up(f / "referenceB.0000.exr", "R", math.nan),
        r"referenceB\.0000\.exr: 1 of 105 values of rgb are not finite.*render",
    ),
    "infinite sample": (
        lambda f: touch_up(f / "pool.path.0001.exr", "s3.B", math.inf),
        r"pool\.path\.0001\.exr: 1 of 105 values of s3 are not finite.*render",
    ),
    "infinite after exposure": (
        lambda f: (
            touch_up(f / "referenceB.0000.exr", "R", 3e38),
            edit(f, "exposure = 0.5", "exposure = 2.0"),
        ),
        r"referenceB\.0000\.exr: rgb has 3e\+38, which exceeds float32 at exposure 2",
    ),
    "depth of minus infinity": (
        lambda f: touch_up(f / "view.0000.exr", "depth.Z", -math.inf),
        r"view\.0000\.exr: 1 of 35 values of depth are not finite.*render",
    ),
    "truncated": (
        lambda f: _cut(f / "pool.path.0001.exr", 0.6),
        r"pool\.path\.0001\.exr cannot be decoded, truncated or corrupt.*delete it.*render",
    ),
    "empty": (lambda f: _cut(f / "view.0001.exr", 0), r"view\.0001\.exr cannot be decoded.*render"),
    "no channel": (
        lambda f: edit(f, "pool_spp = 4", "pool_spp = 5"),
        r"pool\.path\.0000\.exr has no channel s4\.R.*it has: s0\.B",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_clip_is_reported_with_a_remedy(folder, kind):
    break_it, message = BROKEN[kind]
    break_it(folder)
    with pytest.raises(ClipError, match=message):
        [frame.reference.mean for frame in open_clip(folder)]
    assert verify(folder) != []


def test_verify_lists_every_broken_file(folder):
    (folder / "view.0000.exr").unlink()
    _cut(folder / "referenceA.0001.exr", 0.5)
    assert [problem.split()[0].split("/")[-1] for problem in verify(folder)] == [
        "view.0000.exr",
        "referenceA.0001.exr",
    ]


def test_a_mistyped_folder_is_reported_with_the_clips_beside_it(folder):
    with pytest.raises(ClipError, match=r"no clip folder .*stret; clips in .*/clips: street$"):
        open_clip(folder.with_name("stret"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inputs": frozenset({"albedo", "normal"})}, "no buffer normal; it has: albedo, depth"),
        ({"pool": "restir"}, "no pool 'restir'; it has: path"),
        ({"max_samples": 0}, "max_samples is 0 .* must be at least 1"),
    ],
)
def test_what_a_clip_does_not_have_is_answered_with_what_it_has(tmp_path, options, message):
    write_clip(tmp_path, replace(HEADER, buffers=("albedo", "depth")))
    with pytest.raises(ClipError, match=message):
        open_clip(tmp_path, **{"inputs": frozenset()} | options)


def test_a_broken_buffer_that_is_not_read_is_ignored(folder):
    touch_up(folder / "view.0000.exr", "normal.X", math.nan)
    assert len(list(open_clip(folder, inputs=frozenset({"albedo"})))) == FRAMES


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("albedo", np.zeros((H, W)), "frame 3: albedo has shape"),
        ("a", np.full((H, W, 3), np.nan), "frame 3: 105 values of referenceA are not finite"),
        ("pool", np.zeros((STORED, H, W + 1, 3)), "frame 3: pool.path has shape"),
        ("albedo", np.full((H, W, 3), 1e5), "105 values of albedo exceed 65504, .* float16"),
        ("pool", np.full((STORED, H, W, 3), 1e39), "420 values of pool.path exceed 3.*float32"),
        ("b", np.full((H, W, 3), 1e39), "105 values of referenceB exceed 3.*float32"),
        ("depth", np.full((H, W, 1), 1e39), "35 values of depth exceed 3"),  # background if read
    ],
)
def test_an_invalid_image_is_not_written(tmp_path, name, value, message):
    images = content(3) | {name: value}
    gbuffer = {each: images[each] for each in ("albedo", "depth")}
    with pytest.raises(ClipError, match=message):
        write_frame(tmp_path, 3, gbuffer, {"path": images["pool"]}, images["a"], images["b"])
    assert list(tmp_path.glob("*.exr")) == []


# Folders that a user names


def test_clips_of_several_folders_are_found_in_order(tmp_path):
    clips = [write_noise(tmp_path / "a" / name) for name in ("attic", "foyer")]
    clips.append(write_noise(tmp_path / "cellar"))
    assert find_all_clips([tmp_path / "a", tmp_path / "cellar"]) == clips


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("clips", r"further down.*: \S+/clips/falcor, \S+/clips/unreal$"),
        ("none", "no clip in .*; a clip is a folder that contains clip.toml"),
        ("a.exr", "a.exr is a file. Name a folder"),
    ],
)
def test_a_folder_without_clips_is_answered_with_what_to_name(tmp_path, name, message):
    for renderer in ("falcor", "unreal"):
        write_noise(tmp_path / "clips" / renderer / "attic")
    (tmp_path / "none").mkdir()
    (tmp_path / "a.exr").touch()
    with pytest.raises(ClipError, match=message):
        find_all_clips([tmp_path / name])
