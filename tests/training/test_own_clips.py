"""A user's own clips: which are found, and which are refused with a reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.clips.header import ClipError
from rlbench.clips.stored import open_clip
from rlbench.errors import OptionError
from rlbench.family import Traits
from rlbench.training.batches import BatchError
from rlbench.training.own_clips import check_clips, describe_small_pools, find_own_clips
from tests.conftest import write_noise


@pytest.fixture
def shots(tmp_path: Path) -> Path:
    for name in ("a1", "a2", "b1"):
        write_noise(tmp_path / "shots" / name, frames=1)
    return tmp_path / "shots"


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["a1"], ["a1"]),
        ([""], ["a1", "a2", "b1"]),
        (["a*"], ["a1", "a2"]),
        (["[ab]1", "b?"], ["a1", "b1"]),
        (["a1", "", "../shots/a1"], ["a1", "a2", "b1"]),
    ],
)
def test_folders_and_patterns_name_each_clip_once(shots, words, names):
    found = find_own_clips([f"{shots}/{word}" for word in words])
    assert [folder.name for folder in found] == names


def test_a_pattern_that_matches_nothing_is_an_error(shots):
    with pytest.raises(ClipError, match=r"no folder matches '.*c\*'. Name a folder"):
        find_own_clips([f"{shots}/c*"])


@pytest.mark.parametrize(
    ("preset", "scene", "use", "allowed"),
    [
        ("mini", "hall", "train", False),
        ("mini", "kitchen", "train", True),  # a scene of one's own, at the size of a preset
        ("unseen", "generated-400", "train", False),
        ("unseen-views", "generated-400", "train", False),
        ("development", "generated-040", "train", False),
        ("development", "generated-040", "decide", True),
        ("unseen", "generated-400", "decide", False),
        ("train-cap64", "generated-001", "train", True),
        ("elsewhere", "attic", "train", False),  # of another package
        ("", "attic", "train", True),
    ],
)
def test_a_clip_of_a_scored_preset_is_refused_by_its_header(tmp_path, preset, scene, use, allowed):
    folder = write_noise(tmp_path / scene, scene, frames=1, preset=preset)
    if allowed:
        assert find_own_clips([folder], use) == [folder]
        return
    with pytest.raises(OptionError, match=f"clip '{scene}' .* belongs to preset '{preset}'"):
        find_own_clips([folder], use)


def _without_reference(folder: Path) -> None:
    (folder / "referenceB.0001.exr").unlink()


@pytest.mark.parametrize(
    ("traits", "change", "message"),
    [
        (Traits(inputs=frozenset({"object"})), None, "bad: needs buffers object, the clip has"),
        (Traits(pool="restir"), None, "bad: needs a 'restir' pool, the clip has: path"),
        (Traits(spp_range=(4, 8)), None, "bad: supports 4 to 8 spp, requested 2"),
        (Traits(), _without_reference, "bad: .*reference of every frame"),
    ],
)
def test_a_clip_that_cannot_train_a_method_is_named_with_the_reason(
    tmp_path, traits, change, message
):
    folder = write_noise(tmp_path / "bad", frames=2, pool_spp=2)
    if change:
        change(folder)
    with pytest.raises(BatchError, match=message):
        check_clips("mine", traits, [folder], 16, [4.0])


def test_a_clip_smaller_than_a_crop_can_validate_and_not_train(tmp_path):
    folder = write_noise(tmp_path / "small", frames=1, h=20, w=24)
    check_clips("mine", Traits(), [folder], 0, [])
    with pytest.raises(BatchError, match=r"small: has 20 x 24 pixels, .*choose --crop 20 or less"):
        check_clips("mine", Traits(), [folder], 32, [])


def test_clips_with_fewer_samples_than_the_largest_budget_are_listed(tmp_path):
    pools = {"two": 2, "four": 4}
    clips = [open_clip(write_noise(tmp_path / name, pool_spp=n)) for name, n in pools.items()]
    assert describe_small_pools(clips, [1.0, 2.0]) == ""
    text = describe_small_pools(clips, [1.0, 4.0])
    assert text.startswith("1 of 2 clips store fewer samples per pixel than the largest budget of")
    assert "(two 2)" in text
