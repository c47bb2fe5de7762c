"""Training and validation clips: which are found, and which are refused with a reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.apps.render.jobs import render_clips
from rlbench.clips.header import ClipError
from rlbench.clips.stored import open_clip
from rlbench.errors import OptionError
from rlbench.family import Traits
from rlbench.system import paths
from rlbench.training import dataset
from rlbench.training.batches import BatchError
from rlbench.training.dataset import check_clips, describe_small_pools, find_own_clips
from tests.conftest import write_noise


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[tuple]:
    """The preset, scenes and seeds of all clips that are requested; none is rendered."""
    requested = []

    def ensure(preset, scenes, seeds, executor, limit_frames):
        requested.append((preset.name, scenes, seeds))
        return [Path(preset.name, str(name)) for name in scenes or seeds or range(4)]

    monkeypatch.setattr(render_clips, "ensure", ensure)
    return requested


@pytest.mark.parametrize(
    ("seeds", "training", "validating"),
    [(None, "13", "02"), ((30, 31), ["31"], ["30"]), ((7,), ["7"], ["7"])],
)
def test_the_first_and_the_middle_clip_validate(rendered, seeds, training, validating):
    split = dataset.select_split(None, seeds, None)
    assert split.train == [Path("train", name) for name in training]
    assert split.validation == {"train": [Path("train", name) for name in validating]}
    assert rendered == [("train", None, seeds)]
    is_same = split.remark == "validated on the clip that it was trained on"
    assert is_same == (training == validating)


@pytest.fixture
def small_quick_clips(monkeypatch):
    monkeypatch.setattr(dataset, "QUICK_CLIPS", 3)
    monkeypatch.setattr(dataset, "QUICK_SIDE", 32)


def test_a_quick_split_renders_nothing_and_is_written_once(rendered, small_quick_clips):
    split = dataset.split_quick({"path"})
    (folder,) = split.train
    assert open_clip(folder).name == "procedural-0"
    assert [folder.name for folder in split.validation["quick"]] == ["procedural-1", "procedural-2"]
    assert split.remark.startswith("quick: ")
    assert rendered == []
    before = {file: file.stat().st_mtime_ns for file in folder.iterdir()}
    dataset.split_quick({"path"})
    assert {file: file.stat().st_mtime_ns for file in folder.iterdir()} == before


def test_a_quick_training_has_samples_of_a_path_tracer_alone():
    with pytest.raises(OptionError, match="pool 'path', and a method needs 'restir'. Train it wit"):
        dataset.split_quick({"path", "restir"})


def test_clips_that_were_never_rendered_are_counted():
    assert dataset.count_unrendered("train", None) == (28, 28)
    file = paths.clips_folder() / "train" / "generated-003" / "clip.toml"
    file.parent.mkdir(parents=True)
    file.touch()
    assert dataset.count_unrendered("train", (3, 30)) == (1, 2)


def test_seeds_can_be_rendered_at_the_size_of_a_test_set(rendered):
    dataset.select_split("mini", (30, 31), None)
    assert rendered == [("mini", None, (30, 31))]


def test_a_held_out_scene_is_neither_trained_nor_validated_on(rendered):
    split = dataset.select_split("standard", None, "hall")
    assert split.train == [Path("standard", name) for name in ("city", "temple", "ripples")]
    assert split.validation == {"train": [Path("train", "0"), Path("train", "14")]}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None, None, "attic"), "no scene 'attic' to hold out: preset 'mini' has: city, temple"),
        (("train", None, "hall"), "needs a preset with named scenes, and 'train' has none"),
        ((None, (0, 9), "hall"), "--seeds applies to generated scenes only"),
        (("mini", None, None), "preset 'mini' is a test set .*must not be trained on it"),
        (("train,unseen", None, None), "preset 'unseen' is a test set"),
        (("train,train-eventful", (1, 2), None), "--seeds applies to one preset"),
        ((None, None, "hall", None, None, (), ["development"]), "--holdout .* names other clips"),
        ((None, (399, 400, 401), None), "--seeds 400, 401: these belong to test set 'unseen'"),
    ],
)
def test_a_choice_that_cannot_be_trained_on_is_refused(rendered, arguments, message):
    with pytest.raises(OptionError, match=message):
        dataset.select_split(*arguments)
    assert rendered == []


@pytest.fixture
def own(tmp_path: Path) -> Path:
    for number in range(10):
        write_noise(tmp_path / "own" / f"shot-{number}", frames=1)
    return tmp_path / "own"


@pytest.mark.parametrize(("clips", "validating"), [(2, [2]), (7, [7]), (8, [8]), (16, [8, 16])])
def test_every_eighth_clip_validates_and_at_least_one(clips, validating):
    folders = [Path(str(number)) for number in range(1, clips + 1)]
    train, validation = dataset.split_off_validation(folders)
    assert validation == [Path(str(number)) for number in validating]
    assert sorted([*train, *validation]) == sorted(folders)


def test_sets_have_names_of_their_own_or_those_of_folders(own):
    words = [f"{own}/shot-1", f"real={own}/shot-2", f"real={own}/shot-3"]
    names = {
        name: [f.name for f in clips] for name, clips in dataset.select_validation(words).items()
    }
    assert names == {"shot-1": ["shot-1"], "real": ["shot-2", "shot-3"]}


@pytest.mark.usefixtures("rendered")
@pytest.mark.parametrize("preset", ["development", "mini", "unseen", "standard"])
def test_a_preset_for_decisions_validates_and_a_reported_one_does_not(preset):
    if preset == "development":
        assert len(dataset.select_validation([preset])[preset]) == 4
        return
    with pytest.raises(OptionError, match=f"--validate {preset}: this is a reported test set"):
        dataset.select_validation([preset])


def test_own_clips_train_and_validate_alone(own):
    split = dataset.select_split(None, None, None, clips=[str(own)])
    assert [len(split.train), len(split.mixed_in)] == [9, 0]
    assert [folder.name for folder in split.validation["clips"]] == ["shot-7"]
    assert split.summary == (
        "9 clips train; these validate and are not trained on: clips, 1 (shot-7)"
    )


@pytest.mark.usefixtures("rendered")
def test_presets_and_own_clips_are_mixed_in_together(own):
    split = dataset.select_split("train", None, None, clips=["train-eventful", f"{own}/shot-1"])
    eventful = [f"{n}" for n in range(4)]
    assert [folder.name for folder in split.mixed_in] == [*eventful]  # shot-1 validates
    assert split.validation["clips"] == [own / "shot-1"]


def test_a_clip_that_validates_is_not_trained_on(own):
    words = [f"a={own}/shot-0", f"b={own}/shot-[12]"]
    split = dataset.select_split(None, None, None, clips=[str(own)], validate=words)
    assert [folder.name for folder in split.train] == [f"shot-{n}" for n in range(3, 10)]
    assert {name: len(clips) for name, clips in split.validation.items()} == {"a": 1, "b": 2}


def test_a_training_whose_clips_all_validate_is_refused(own):
    with pytest.raises(OptionError, match=r"all 10 clips to train on \(shot-0, .*\) validate"):
        dataset.select_split(None, None, None, clips=[str(own)], validate=[str(own)])


@pytest.mark.usefixtures("rendered")
def test_own_clips_are_mixed_into_those_of_several_presets(own):
    split = dataset.select_split("train, train-eventful", None, None, clips=[str(own)])
    assert [str(folder) for folder in split.train] == [
        f"{preset}/{n}" for preset in ("train", "train-eventful") for n in (1, 3)
    ]
    assert len(split.mixed_in) == 9
    assert list(split.validation) == ["train", "train-eventful", "clips"]


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
