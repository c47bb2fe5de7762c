"""Validation sets: by name, split off the training clips, and never trained on."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.errors import OptionError
from rlbench.render.jobs import render_clips
from rlbench.training import dataset
from rlbench.training.dataset import select_validation, split_off_validation
from tests.conftest import write_noise


@pytest.fixture
def own(tmp_path: Path) -> Path:
    for number in range(10):
        write_noise(tmp_path / "own" / f"shot-{number}", frames=1)
    return tmp_path / "own"


@pytest.fixture
def _rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clips of presets are paths, and none is rendered."""

    def ensure(preset, scenes, seeds, executor):
        return [Path(preset.name, str(seed)) for seed in seeds or range(4)]

    monkeypatch.setattr(render_clips, "ensure", ensure)


@pytest.mark.parametrize(("clips", "validating"), [(2, [2]), (7, [7]), (8, [8]), (16, [8, 16])])
def test_every_eighth_clip_validates_and_at_least_one(clips, validating):
    folders = [Path(str(number)) for number in range(1, clips + 1)]
    train, validation = split_off_validation(folders)
    assert validation == [Path(str(number)) for number in validating]
    assert sorted([*train, *validation]) == sorted(folders)


def test_sets_have_names_of_their_own_or_those_of_folders(own):
    words = [f"{own}/shot-1", f"real={own}/shot-2", f"real={own}/shot-3"]
    names = {name: [f.name for f in clips] for name, clips in select_validation(words).items()}
    assert names == {"shot-1": ["shot-1"], "real": ["shot-2", "shot-3"]}


@pytest.mark.usefixtures("_rendered")
def test_a_preset_for_decisions_validates_under_its_name():
    assert select_validation(["development"])["development"] == [
        Path("development", str(number)) for number in range(4)
    ]


@pytest.mark.usefixtures("_rendered")
@pytest.mark.parametrize("preset", ["mini", "unseen", "standard"])
def test_a_reported_preset_does_not_validate(preset):
    with pytest.raises(OptionError, match=f"--validate {preset}: this is a reported test set"):
        select_validation([preset])


def test_own_clips_train_and_validate_alone(own):
    split = dataset.select_split(None, None, None, clips=[str(own)])
    assert [len(split.train), len(split.mixed_in)] == [9, 0]
    assert [folder.name for folder in split.validation["clips"]] == ["shot-7"]
    assert split.summary == (
        "9 clips train; these validate and are not trained on: clips, 1 (shot-7)"
    )


def test_a_clip_that_validates_is_not_trained_on(own):
    words = [f"a={own}/shot-0", f"b={own}/shot-[12]"]
    split = dataset.select_split(None, None, None, clips=[str(own)], validate=words)
    assert [folder.name for folder in split.train] == [f"shot-{n}" for n in range(3, 10)]
    assert {name: len(clips) for name, clips in split.validation.items()} == {"a": 1, "b": 2}


def test_a_training_whose_clips_all_validate_is_refused(own):
    with pytest.raises(OptionError, match=r"all 10 clips to train on \(shot-0, .*\) validate"):
        dataset.select_split(None, None, None, clips=[str(own)], validate=[str(own)])


@pytest.mark.usefixtures("_rendered")
def test_own_clips_are_mixed_into_those_of_several_presets(own):
    split = dataset.select_split("train, train-eventful", None, None, clips=[str(own)])
    assert [str(folder) for folder in split.train] == [
        f"{preset}/{n}" for preset in ("train", "train-eventful") for n in (1, 3)
    ]
    assert len(split.mixed_in) == 9
    assert list(split.validation) == ["train", "train-eventful", "clips"]


@pytest.mark.usefixtures("_rendered")
@pytest.mark.parametrize(
    ("arguments", "validate", "message"),
    [
        (("train,unseen", None, None), (), "preset 'unseen' is a test set"),
        (("train,train-eventful", (1, 2), None), (), "--seeds applies to one preset"),
        ((None, None, "hall"), ("development",), "--holdout .* and --validate names other clips"),
    ],
)
def test_choices_that_contradict_each_other_are_refused(arguments, validate, message):
    with pytest.raises(OptionError, match=message):
        dataset.select_split(*arguments, validate=validate)
