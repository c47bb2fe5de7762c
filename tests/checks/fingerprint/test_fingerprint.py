"""What a buffer is worth to a method: known costs, and the files of the command."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass

import pytest
import torch
from typer.testing import CliRunner

from rlbench import Traits
from rlbench.checks.fingerprint.measure import EDITS, measure_losses
from rlbench.checks.frame_edits import to_clip
from rlbench.cli.app import app
from rlbench.clips.importers.stand_ins import STAND_INS
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.errors import OptionError
from rlbench.frames import Size
from rlbench.ops.color import encode_srgb
from tests.procedural_folder import write_world


@dataclass(frozen=True)
class ShowAlbedo:
    """Returns albedo as its image, and reads depth without using it."""

    traits: Traits = Traits(inputs=frozenset({"albedo", "depth"}))

    def start(self, size):
        return None

    def plan(self, gbuffer, samples, state):
        return torch.ones_like(gbuffer.depth)

    def denoise(self, gbuffer, samples, state):
        return gbuffer.albedo, None


@pytest.fixture(scope="module")
def frames():
    return tuple(procedural_clip(3, Size(1, 16, 24), 4))


@pytest.fixture(scope="module")
def losses(frames):
    found = measure_losses("show", ShowAlbedo(), to_clip(frames), 1.0)
    return {(loss.buffer, loss.edit): loss for loss in found}


def test_every_edit_of_every_declared_buffer_is_measured(losses):
    assert list(losses) == [(buffer, edit) for buffer in ("albedo", "depth") for edit in EDITS]


def test_a_buffer_without_effect_on_the_image_costs_nothing(losses):
    assert [losses["depth", edit].lost_db for edit in EDITS] == [0, 0, 0, 0]


def albedo_psnr(frames, edited) -> float:
    """PSNR of albedo as an image, mean of all frames but two, by its definition."""
    scores = []
    for frame, image in list(zip(frames, edited, strict=True))[2:]:
        display, truth = (encode_srgb(x.clamp(0, 1)) for x in (image, frame.reference.mean))
        scores.append(-10 * (display - truth).square().mean().log10())
    return float(torch.stack(scores).mean())


def test_the_loss_is_the_difference_of_two_psnr(losses, frames):
    albedo = [frame.gbuffer.albedo for frame in frames]
    lagged = [albedo[max(i - 1, 0)] for i in range(len(albedo))]
    dropped = [torch.full_like(image, STAND_INS["albedo"][0]) for image in albedo]
    right = albedo_psnr(frames, albedo)
    for edit, edited in (("lagged", lagged), ("dropped", dropped)):
        # float32 sums over a few hundred pixels
        expected = right - albedo_psnr(frames, edited)
        assert losses["albedo", edit].lost_db == pytest.approx(expected, abs=1e-3)


def test_jitter_shifts_a_buffer_by_one_pixel(frames):
    right = [frame.gbuffer.albedo for frame in frames]
    shifted = EDITS["jittered"]("albedo", right, 0)
    torch.testing.assert_close(shifted[..., 1:], right[0][..., :-1], rtol=0, atol=0)
    shifted = EDITS["jittered"]("albedo", right, 3)
    torch.testing.assert_close(shifted[..., :-1, :], right[3][..., 1:, :], rtol=0, atol=0)


def test_a_clip_of_two_frames_is_too_short(frames):
    with pytest.raises(OptionError, match="has 2 frames read; a fingerprint needs 3"):
        list(measure_losses("show", ShowAlbedo(), to_clip(frames[:2]), 1.0))


def test_the_command_writes_a_row_per_buffer_and_edit(tmp_path):
    write_world(tmp_path / "clips" / "room", side=32)
    out = tmp_path / "out"
    words = ["fingerprint", "eaw", "--clips", str(tmp_path / "clips"), "--out", str(out)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "dB lost" in result.output
    with (out / "fingerprint.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["lost_db"]) for row in rows] == [
        row["lost_db"] for row in json.loads((out / "fingerprint.json").read_text())
    ]
    assert len(rows) % len(EDITS) == 0
    assert {row["clip"] for row in rows} == {"room"}
