"""Training and validation clips: nothing of a test set is trained on."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.clips.stored import open_clip
from rlbench.errors import OptionError
from rlbench.render.jobs import render_clips
from rlbench.system import paths
from rlbench.training import dataset


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[tuple]:
    """The preset, scenes and seeds of all clips that are requested; none is rendered."""
    requested = []

    def ensure(preset, scenes, seeds, executor):
        requested.append((preset.name, scenes, seeds))
        return [Path(preset.name, str(name)) for name in scenes or seeds or range(4)]

    monkeypatch.setattr(render_clips, "ensure", ensure)
    return requested


def test_the_first_and_the_middle_clip_validate(rendered):
    split = dataset.split_generated("train")
    assert split.train == [Path("train", name) for name in "13"]
    assert split.validation == {"train": [Path("train", name) for name in "02"]}
    assert rendered == [("train", None, None)]


def test_of_two_clips_one_validates(rendered):
    split = dataset.split_generated("train", (30, 31))
    assert (split.train, split.validation) == (
        [Path("train", "31")],
        {"train": [Path("train", "30")]},
    )
    assert rendered == [("train", None, (30, 31))]


def test_one_clip_trains_and_validates_and_the_split_says_so(rendered):
    split = dataset.select_split(None, (7,), None)
    assert split.train == split.validation["train"] == [Path("train", "7")]
    assert split.remark == "validated on the clip that it was trained on"


@pytest.fixture
def small_quick_clips(monkeypatch):
    monkeypatch.setattr(dataset, "QUICK_CLIPS", 3)
    monkeypatch.setattr(dataset, "QUICK_SIDE", 32)


def test_a_quick_split_renders_nothing_and_validates_on_other_clips(rendered, small_quick_clips):
    split = dataset.split_quick({"path"})
    assert [open_clip(folder).name for folder in split.train] == ["procedural-0"]
    assert [folder.name for folder in split.validation["quick"]] == ["procedural-1", "procedural-2"]
    assert split.remark.startswith("quick: ")
    assert rendered == []


def test_quick_clips_are_written_once(small_quick_clips):
    (folder,) = dataset.split_quick({"path"}).train
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
        ((None, (399, 400, 401), None), "--seeds 400, 401: these belong to test set 'unseen'"),
    ],
)
def test_a_choice_that_cannot_be_trained_on_is_refused(rendered, arguments, message):
    with pytest.raises(OptionError, match=message):
        dataset.select_split(*arguments)
    assert rendered == []
