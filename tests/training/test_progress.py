"""The progress of a run: the note in the model card, and the progress bar's text."""

from __future__ import annotations

import pytest

from rlbench.cli import console
from rlbench.training import Progress
from rlbench.training.checkpoint import combine_digests, describe_changes


def test_the_progress_bar_shows_loss_validation_and_speed():
    history = [(3, 20.0), (6, 21.5)]
    progress = Progress(frames_seen=6, frames_per_second=12.34, validation_history=history)
    status = console.training_status(progress, 0.12345)
    assert status == "loss 0.1235, validation 21.50 dB, 12.3 frames/s"
    assert console.training_status(Progress(), 1.0) == "loss 1.0000, 0.0 frames/s"


def test_the_progress_bar_shows_each_of_several_validation_sets():
    curves = {"train": [(3, 20.0, 18.0)], "real": [(3, 24.0, 21.0)]}
    progress = Progress(validation_history=[(3, 22.0)], curves=curves)
    status = console.training_status(progress, 0.5)
    assert status == "loss 0.5000, validation 22.00 dB (train 20.00, real 24.00), 0.0 frames/s"


def test_many_clips_of_a_changed_config_are_counted():
    clips = [f"shot-{number} 0123" for number in range(9)]
    (change,) = describe_changes({"data": clips}, {"data": clips[:1]})
    assert change == f"data 9 clips {combine_digests(clips)} -> ['shot-0 0123']"


@pytest.mark.parametrize(
    ("frames", "history", "expected"),
    [
        (500, [], "stopped at 500 of 3000 frames"),
        (3000, [(1000, 20.0), (2000, 24.0), (3000, 24.5)], "rose by 0.50 dB in the last fifth"),
        (3000, [(1000, 20.0), (2000, 24.0), (3000, 24.05)], ""),
        (3000, [(1000, 20.0), (2000, 24.0), (3000, 23.0)], ""),
        (1000, [(1000, 20.0)], "stopped"),
    ],
)
def test_the_note_says_if_training_was_too_short(frames, history, expected):
    note = Progress(frames_seen=frames, validation_history=history).note(3000)
    assert expected in note
    assert bool(note) == bool(expected)


@pytest.mark.parametrize(
    ("rises", "trend"),
    [([], ""), ([3.0], ""), ([3.0] + [0.0] * 9, "flat"), ([0.03] * 10, "flat")]
    + [([0.06] * 10, "rising"), ([1.0, 1.0], "rising"), ([1.0, -1.0], "flat")],
)
def test_the_trend_is_that_of_the_last_fifth(rises, trend):
    history = [(1000 * n, sum(rises[:n])) for n in range(1, len(rises) + 1)]
    assert Progress(validation_history=history).trend == trend


def test_a_change_of_the_config_is_noted_with_its_frame():
    progress = Progress(frames_seen=9, config={"bf16": True, "crop": 16})
    progress.switch_config({"bf16": False, "crop": 16})
    assert progress.note(9) == "after 9 frames: bf16 True -> False"
    assert progress.config == {"bf16": False, "crop": 16}
