"""Classes of pixels follow the conventions of clips."""

from __future__ import annotations

import numpy as np
import pytest

from reports.error_places import KINDS, classify, error_shares

SIZE = (8, 10)


def motion_of(x, y, frames=2):
    return np.broadcast_to(np.float32([x, y])[None, :, None, None], (frames, 2, *SIZE)).copy()


def black(frames=2):
    return np.zeros((frames, 3, *SIZE), np.float32)


def depth_of(value=1.0, frames=2):
    return np.full((frames, 1, *SIZE), value, np.float32)


@pytest.mark.parametrize(("speed", "name"), [(0.0, "still"), (1.0, "slow"), (-3.0, "fast")])
def test_motion_is_classified_by_its_length(speed, name):
    found = classify(black(), {"motion": motion_of(0, speed)})["motion"]
    assert set(found.ravel()) == {KINDS["motion"].index(name)}


def test_a_pixel_from_outside_of_the_frame_is_disoccluded():
    found = classify(black(), {"motion": motion_of(3, 0), "depth": depth_of()})["visibility"]
    assert found[0].all()  # nothing is before the first frame
    assert found[1, :, :7].sum() == 0
    assert found[1, :, 7:].all()


def test_a_pixel_behind_another_surface_before_is_disoccluded():
    depth = depth_of()
    depth[0, 0, :, 4] = 0.5  # a pole stood here
    found = classify(black(), {"motion": motion_of(0, 0), "depth": depth})["visibility"][1]
    assert found[:, 4].all()
    assert found.sum() == SIZE[0]


def test_a_step_of_depth_is_an_edge_and_infinite_background_is_smooth():
    depth = depth_of(np.inf)
    assert not classify(black(), {"depth": depth})["geometry"].any()
    depth[:, :, :, 5:] = 2.0
    columns = classify(black(), {"depth": depth})["geometry"][0].any(axis=0)
    assert np.flatnonzero(columns).tolist() == [4, 5, 6]


def test_luminance_has_three_bands():
    reference = black()
    reference[..., 1], reference[..., 2] = 0.2, 3.0
    assert set(classify(reference, {})) == {"luminance"}
    assert classify(reference, {})["luminance"][0, 0, :4].tolist() == [0, 1, 2, 0]


def test_the_surface_of_a_pixel_seen_before_is_where_its_motion_leads(kept):
    clip = kept.clips[0]
    hidden = classify(clip.reference, clip.buffers)["visibility"][1].astype(bool)
    motion, albedo = clip.buffers["motion"][1], clip.buffers["albedo"]
    y, x = np.indices(hidden.shape)
    rows = np.rint(y + motion[1]).clip(0, hidden.shape[0] - 1).astype(int)
    columns = np.rint(x + motion[0]).clip(0, hidden.shape[1] - 1).astype(int)
    change = abs(albedo[0][:, rows, columns] - albedo[1]).mean(axis=0)
    assert 0 < hidden.mean() < 0.5
    assert change[~hidden].mean() < 0.5 * change[hidden].mean()


def test_the_shares_of_a_kind_add_to_one(kept):
    shares = error_shares(kept.clips, ["eaw", "mean"])
    sums = shares.groupby(["method", "scene", "kind"])[["pixels", "error"]].sum()
    assert set(shares["kind"]) == set(KINDS)
    assert sums.to_numpy() == pytest.approx(np.ones((len(sums), 2)))
