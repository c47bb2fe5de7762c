"""A clip folder gives back what was written, only what was asked, and says what is broken."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from rlbench.clips import decode_cache
from rlbench.clips import stored as clips
from rlbench.clips.exr import write_exr
from rlbench.clips.stored import (
    ClipError,
    Header,
    has_frame,
    open_clip,
    read_header,
    verify,
    write_frame,
    write_header,
)
from rlbench.system import paths

H, W, FRAMES, STORED = 5, 7, 2, 4
HEADER = Header(
    name="street/mini",
    scene="street",
    sampler="by hand",
    height=H,
    width=W,
    frames=FRAMES,
    exposure=0.5,
    pool_spp=STORED,
    reference_spp=(64, 32),
)


@pytest.fixture(autouse=True)
def _own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path / "cache"))


def content(index: int) -> dict[str, np.ndarray]:
    """All images of one frame, in double precision, h w c."""
    rng = np.random.default_rng(index)
    depth = rng.uniform(1, 1e4, (H, W, 1))
    depth[0, 0] = np.inf
    return {
        "albedo": rng.random((H, W, 3)),
        "normal": rng.uniform(-1, 1, (H, W, 3)),
        "depth": depth,
        "motion": rng.normal(0, 100, (H, W, 2)),
        "pool": rng.exponential(1.0, (STORED, H, W, 3)),
        "a": rng.exponential(1.0, (H, W, 3)),
        "b": rng.exponential(1.0, (H, W, 3)),
    }


def write(folder: Path, header: Header = HEADER) -> Path:
    for index in range(header.frames):
        images = content(index)
        gbuffer = {name: images[name] for name in header.buffers}
        write_frame(folder, index, gbuffer, {"path": images["pool"]}, images["a"], images["b"])
    write_header(folder, header)
    return folder


@pytest.fixture
def folder(tmp_path):
    return write(tmp_path / "clips" / "street")


def decoded_files() -> set[str]:
    """What lies in the decoded cache, as kind/name.frame."""
    return {"/".join(p.parts[-2:])[: -len(".npy")] for p in paths.decoded().rglob("*.npy")}


def touch_up(path: Path, channel: str, value: float) -> None:
    """Set one value of a channel of a file."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = {name: np.array(c.pixels) for name, c in file.channels().items()}
    planes[channel][1, 2] = value
    write_exr(path, planes)


# What was written comes back


@pytest.mark.parametrize(
    ("buffer", "precision"),
    [
        ("albedo", np.float16),
        ("normal", np.float16),
        ("depth", np.float32),
        ("motion", np.float32),
    ],
)
def test_a_view_buffer_comes_back_at_its_precision(folder, buffer, precision):
    stored = open_clip(folder).frame(1).gbuffer.buffers[buffer][0].permute(1, 2, 0).numpy()
    np.testing.assert_array_equal(stored, content(1)[buffer].astype(precision).astype(np.float32))


@pytest.mark.parametrize("half", ["a", "b"])
def test_a_reference_comes_back_as_exposed_floats(folder, half):
    stored = getattr(open_clip(folder).frame(0).reference, half)[0].permute(1, 2, 0).numpy()
    np.testing.assert_array_equal(stored, content(0)[half].astype(np.float32) * np.float32(0.5))


def test_the_pool_comes_back_as_exposed_halves_in_some_order(folder):
    sold = open_clip(folder).frame(0).pool.radiance[0].permute(0, 2, 3, 1).numpy()
    written = content(0)["pool"].astype(np.float16).astype(np.float32) * np.float32(0.5)
    assert {image.tobytes() for image in sold} == {image.tobytes() for image in written}


def test_a_firefly_beyond_half_precision_is_not_clipped(tmp_path):
    images = content(0)
    images["pool"][2, 1, 1] = 3e6
    gbuffer = {"depth": images["depth"]}
    write_frame(tmp_path, 0, gbuffer, {"path": images["pool"]}, images["a"], images["b"])
    write_header(tmp_path, replace(HEADER, frames=1, reference_spp=(1,), buffers=("depth",)))
    assert open_clip(tmp_path, inputs=frozenset()).frame(0).pool.radiance.max() == 1.5e6


def test_other_readers_find_the_channels_that_the_format_names(folder):
    with OpenEXR.File(str(folder / "pool.path.0001.exr"), separate_channels=True) as file:
        found = file.channels()
        assert set(found) == {f"s{s}.{c}" for s in range(STORED) for c in "RGB"}
        assert found["s2.G"].pixels.dtype == np.float16
        np.testing.assert_array_equal(
            found["s2.G"].pixels, content(1)["pool"][2, :, :, 1].astype(np.float16)
        )


def test_a_header_comes_back(tmp_path):
    header = replace(HEADER, licence='CC0 "1.0"\n\\ ü 🙂', sample_ms=12.5, static=True, fps=1e-5)
    write_header(tmp_path, header)
    assert read_header(tmp_path) == header


@settings(deadline=None)
@given(text=st.text(st.characters(exclude_categories=["Cs"])))
def test_any_text_survives_in_toml(text, tmp_path_factory):
    path = tmp_path_factory.mktemp("toml")
    write_header(path, replace(HEADER, licence=text))
    assert tomllib.loads((path / "clip.toml").read_text("utf-8"))["licence"] == text


def test_a_header_tells_where_shots_begin(tmp_path):
    write_header(tmp_path, replace(HEADER, cuts=(1,)))
    assert read_header(tmp_path).cuts == (1,)


@pytest.mark.parametrize(
    "wrong", [{"cuts": (0,)}, {"cuts": (FRAMES,)}, {"cuts": (1,), "static": True}]
)
def test_a_cut_where_there_is_no_frame_before_or_nothing_moves_is_refused(wrong):
    with pytest.raises(
        ClipError, match="expected frames from 1 to 1, of a clip that is not static"
    ):
        replace(HEADER, **wrong)


def test_a_clip_of_one_shot_has_the_digest_that_it_had_before_there_were_cuts(folder):
    before = open_clip(folder).digest
    told = (folder / "clip.toml").read_text("utf-8").replace("cuts = []\n", "")
    (folder / "clip.toml").write_text(told, "utf-8")
    assert open_clip(folder).digest == before


def test_an_unknown_sample_time_is_nan(folder):
    assert math.isnan(read_header(folder).sample_ms)


def test_a_static_clip_has_no_motion(tmp_path):
    still = replace(HEADER, static=True, buffers=("albedo", "normal", "depth"))
    assert open_clip(write(tmp_path, still)).frame(0).gbuffer.motion is None


def test_a_window_is_the_same_pixels_of_the_frame(folder):
    clip = open_clip(folder)
    rows, columns = slice(1, 4), slice(2, 7)
    part, whole = clip.frame(1, (rows, columns)), clip.frame(1)
    assert torch.equal(part.pool.radiance, whole.pool.radiance[..., rows, columns])


def test_frames_come_in_order(folder):
    assert [frame.index for frame in open_clip(folder)] == [0, 1]


def test_the_second_reading_equals_the_first(folder):
    first, second = (open_clip(folder).frame(0) for _ in range(2))
    assert torch.equal(first.pool.radiance, second.pool.radiance)


def test_a_frame_is_there_when_all_of_its_files_are(folder):
    assert has_frame(folder, 1)
    (folder / "referenceB.0001.exr").unlink()
    assert not has_frame(folder, 1)


def test_no_temporary_file_is_left(folder):
    assert len(list(folder.iterdir())) == 4 * FRAMES + 1


# Only what was asked is decoded


def test_opening_decodes_nothing(folder):
    open_clip(folder)
    assert decoded_files() == set()


def test_only_needed_buffers_and_slots_are_decoded(folder):
    open_clip(folder, inputs=frozenset({"depth"}), max_samples=1).frame(1)
    first = clips.sample_order(0, HEADER.name, 1, STORED)[0][0]
    assert decoded_files() == {
        "view/depth.0001",
        f"pool.path/s{first}.0001",
        "referenceA/rgb.0001",
        "referenceB/rgb.0001",
    }


def test_what_was_decoded_is_not_decoded_again(folder, monkeypatch):
    opened = []
    read = decode_cache.read_exr
    monkeypatch.setattr(
        decode_cache, "read_exr", lambda path, *rest: opened.append(path.name) or read(path, *rest)
    )
    open_clip(folder, max_samples=2).frame(0)
    open_clip(folder, max_samples=3).frame(0)
    assert opened.count("view.0000.exr") == 1
    assert opened.count("pool.path.0000.exr") == 2  # the third slot was new


def test_more_slots_than_stored_are_as_many_as_stored(folder):
    assert open_clip(folder, max_samples=99).frame(0).pool.max_samples == STORED


# The order of sale


def test_few_slots_are_the_first_of_many(folder):
    few, many = (open_clip(folder, max_samples=s).frame(0).pool.radiance for s in (2, STORED))
    assert torch.equal(few, many[:, :2])


@settings(deadline=None)
@given(seed=st.integers(0, 2**40), index=st.integers(0, 10**6), stored=st.integers(1, 64))
def test_every_stored_sample_is_sold_once(seed, index, stored):
    assert sorted(clips.sample_order(seed, "clip", index, stored)[0]) == list(range(stored))


@pytest.mark.parametrize("other", [(1, "clip", 0), (0, "other", 0), (0, "clip", 1)])
def test_seed_name_and_frame_each_change_order_and_key(other):
    order, key = clips.sample_order(0, "clip", 0, 64)
    other_order, other_key = clips.sample_order(*other, 64)
    assert (order != other_order, key != other_key) == (True, True)


def test_each_slot_is_as_likely_to_be_sold_first():
    draws = 4000
    first = np.bincount([clips.sample_order(s, "c", 0, 8)[0][0] for s in range(draws)], minlength=8)
    error = math.sqrt(draws / 8 * 7 / 8)
    assert np.abs(first - draws / 8).max() < 4 * error  # 4 standard errors of a binomial


# The digest


def test_one_pixel_changes_the_digest(folder):
    before = open_clip(folder).digest
    touch_up(folder / "referenceA.0001.exr", "G", 7.0)
    assert open_clip(folder).digest != before


def test_a_changed_pixel_is_read_anew(folder):
    open_clip(folder).frame(1)
    touch_up(folder / "referenceA.0001.exr", "G", 7.0)
    assert open_clip(folder).frame(1).reference.half_a[0, 1, 1, 2] == 3.5  # exposed by a half


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({"sample_ms": 3.0}, True),
        ({"device": "another machine"}, True),
        ({"exposure": 2.0}, False),
        ({"name": "another name"}, False),
    ],
)
def test_the_digest_covers_what_decides_pixels(folder, change, same):
    before = open_clip(folder).digest
    write_header(folder, replace(HEADER, **change))
    assert (open_clip(folder).digest == before) is same


def test_files_that_did_not_change_are_hashed_once(folder, monkeypatch):
    before = open_clip(folder).digest
    monkeypatch.setattr(clips.clip_digest.__globals__["hashlib"], "file_digest", None)
    assert open_clip(folder).digest == before  # hashing a file would now be an error


def test_a_moved_clip_keeps_its_digest(folder):
    before = open_clip(folder).digest
    assert open_clip(folder.rename(folder.with_name("moved"))).digest == before


# Broken clips: each says which file, and what would do


def _edit(folder: Path, old: str, new: str) -> None:
    text = (folder / "clip.toml").read_text()
    assert old in text
    (folder / "clip.toml").write_text(text.replace(old, new))


def _cut(path: Path, share: float) -> None:
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])


def _resize(path: Path) -> None:
    write_exr(path, dict.fromkeys("RGB", np.zeros((H, W + 1), np.float32)))


BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "unfinished": (lambda f: (f / "clip.toml").unlink(), r"unfinished.*clip\.toml.*rlbench render"),
    "not toml": (
        lambda f: (f / "clip.toml").write_text("name ="),
        r"clip\.toml is not TOML.*render",
    ),
    "new version": (
        lambda f: _edit(f, "version = 1", "version = 2"),
        r"clip\.toml has format version 2.*reads 1.*update rlbench",
    ),
    "no key": (lambda f: _edit(f, "height", "hight"), r"clip\.toml has no 'height'"),
    "wrong type": (
        lambda f: _edit(f, "frames = 2", 'frames = "2"'),
        r"'frames' is '2', expected int",
    ),
    "contradiction": (lambda f: _edit(f, "frames = 2", "frames = 3"), "lists 2 frames.* has 3"),
    "missing view": (
        lambda f: (f / "view.0001.exr").unlink(),
        r"view\.0001\.exr is missing.*rlbench render",
    ),
    "missing pool": (
        lambda f: (f / "pool.path.0000.exr").unlink(),
        r"pool\.path\.0000\.exr is missing.*rlbench render",
    ),
    "wrong size": (
        lambda f: _resize(f / "referenceA.0001.exr"),
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
    "depth of minus infinity": (
        lambda f: touch_up(f / "view.0000.exr", "depth.Z", -math.inf),
        r"view\.0000\.exr: 1 of 35 values of depth are not finite.*render",
    ),
    "truncated": (
        lambda f: _cut(f / "pool.path.0001.exr", 0.6),
        r"pool\.path\.0001\.exr cannot be decoded, truncated or corrupt.*delete it.*render",
    ),
    "empty": (lambda f: _cut(f / "view.0001.exr", 0), r"view\.0001\.exr cannot be decoded.*render"),
    "no image": (
        lambda f: (f / "view.0000.exr").write_text("<html>"),
        r"view\.0000\.exr cannot be decoded.*render",
    ),
    "no channel": (
        lambda f: _edit(f, "pool_spp = 4", "pool_spp = 5"),
        r"pool\.path\.0000\.exr has no channel s4\.R.*it has: s0\.B",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_clip_says_what_is_wrong_and_what_would_do(folder, kind):
    break_it, message = BROKEN[kind]
    break_it(folder)
    with pytest.raises(ClipError, match=message):
        list(open_clip(folder))


@pytest.mark.parametrize("kind", BROKEN)
def test_verify_finds_what_reading_finds(folder, kind):
    BROKEN[kind][0](folder)
    assert verify(folder) != []


def test_verify_lists_every_broken_file(folder):
    (folder / "view.0000.exr").unlink()
    _cut(folder / "referenceA.0001.exr", 0.5)
    assert [problem.split()[0].split("/")[-1] for problem in verify(folder)] == [
        "view.0000.exr",
        "referenceA.0001.exr",
    ]


def test_verify_finds_nothing_in_a_sound_clip(folder):
    assert verify(folder) == []


def test_no_such_folder_says_what_there_is(folder):
    with pytest.raises(ClipError, match="no clip folder .*stret; there is: street"):
        open_clip(folder.with_name("stret"))


def test_a_missing_buffer_names_those_that_exist(tmp_path):
    write(tmp_path, replace(HEADER, buffers=("albedo", "depth")))
    with pytest.raises(ClipError, match="no buffer normal; it has: albedo, depth"):
        open_clip(tmp_path, inputs=frozenset({"albedo", "normal"}))


def test_a_missing_pool_names_those_that_exist(folder):
    with pytest.raises(ClipError, match="no pool 'restir'; it has: path"):
        open_clip(folder, pool="restir")


def test_no_slots_is_an_error(folder):
    with pytest.raises(ClipError, match="asked for 0 samples"):
        open_clip(folder, max_samples=0)


def test_a_broken_buffer_that_nobody_needs_hurts_nobody(folder):
    touch_up(folder / "view.0000.exr", "normal.X", math.nan)
    assert len(list(open_clip(folder, inputs=frozenset({"albedo"})))) == FRAMES


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("albedo", np.zeros((H, W)), "frame 3: albedo has shape"),
        ("a", np.full((H, W, 3), np.nan), "frame 3: 105 values of referenceA are not finite"),
        ("pool", np.zeros((STORED, H, W + 1, 3)), "frame 3: pool.path has shape"),
    ],
)
def test_what_could_not_be_read_is_not_written(tmp_path, name, value, message):
    images = content(3) | {name: value}
    gbuffer = {"albedo": images["albedo"]}
    with pytest.raises(ClipError, match=message):
        write_frame(tmp_path, 3, gbuffer, {"path": images["pool"]}, images["a"], images["b"])
    assert list(tmp_path.glob("*.exr")) == []


def _interrupted(path: Path) -> None:
    with paths.replacing(path) as temporary:
        temporary.write_text("half of the n")
        raise KeyboardInterrupt


def test_an_interrupted_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        _interrupted(path)
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]
