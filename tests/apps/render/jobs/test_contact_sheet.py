"""The contact sheet: its images, its cache, and its tone curve."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from rlbench.apps.render.jobs import contact_sheet
from rlbench.clips.stored import open_clip
from tests.conftest import write_noise


def test_the_tone_curve_rises_from_black_to_white_and_non_finite_radiance_is_black():
    white = np.array([[[0.0] * 3, [contact_sheet.WHITE] * 3]])
    assert contact_sheet.tone_map(white, 1.0)[0, :, 0].tolist() == [0, 255]
    ramp = np.repeat(np.geomspace(1e-4, 50, 300)[None, :, None], 3, -1)
    mapped = contact_sheet.tone_map(ramp, 1.0)
    assert (np.diff(mapped[0, :, 0].astype(int)) >= 0).all()
    assert np.array_equal(contact_sheet.tone_map(ramp / 3, 3.0), mapped)
    assert not contact_sheet.tone_map(np.array([[[np.nan, np.inf, -np.inf]]]), 1.0).any()


def test_the_third_image_starts_the_second_row():
    pictures = [np.full((3, 5, 3), k, np.uint8) for k in range(3)]
    page = contact_sheet.tile_images(pictures)
    assert page.shape == (6 + contact_sheet.GAP, 10 + contact_sheet.GAP, 3)
    assert page[3 + contact_sheet.GAP :, :5].tolist() == pictures[2].tolist()
    assert (page[3 + contact_sheet.GAP :, 5:] == 255).all()


@pytest.mark.slow
def test_a_second_sheet_traces_nothing_and_is_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(contact_sheet.paths, "cache_folder", lambda: tmp_path)
    sheet = ["temple", "temple"], 16, 2
    first = contact_sheet.trace_images(*sheet)
    monkeypatch.setattr(contact_sheet, "open_tracer", None)
    assert np.array_equal(contact_sheet.trace_images(*sheet), first)


def test_a_sheet_of_clips_shows_the_first_reference_of_each_scene(tmp_path):
    clips = [write_noise(tmp_path / name, name[:4]) for name in ("room-000", "hill-0", "room-1")]
    images = contact_sheet.read_references(clips)
    for image, clip in zip(images, clips[:2], strict=True):
        first = open_clip(clip).frame(0).reference.mean[0].movedim(0, -1).numpy()
        assert np.array_equal(image, contact_sheet.tone_map(first, 1.0))
    (small,) = contact_sheet.read_references(clips[:1], shrink=2)
    first = open_clip(clips[0]).frame(0).reference.mean[0].movedim(0, -1).numpy()
    means = first.reshape(10, 2, 12, 2, 3).mean((1, 3))
    assert np.abs(small.astype(int) - contact_sheet.tone_map(means, 1.0)).max() <= 1  # rounding
    page = Image.open(contact_sheet.write_sheet(3 * images, tmp_path / "sheet.png", columns=5))
    gap = contact_sheet.GAP
    assert page.size == (5 * 24 + 4 * gap, 2 * 20 + gap)
    one = Image.open(contact_sheet.write_sheet(images[:1], tmp_path / "one.png"))
    assert one.size == (24, 20)
