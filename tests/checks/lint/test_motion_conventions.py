"""Conventions of a motion buffer."""

from __future__ import annotations

import torch

from rlbench.checks.lint.motion_conventions import FORMAT_V1, MotionConvention, all_conventions


def test_conventions_are_every_combination_once():
    assert len(set(map(str, all_conventions()))) == len(all_conventions()) == 2 * 4 * 5 * 2


def test_a_convention_converts_stored_motion_to_pixels():
    stored = torch.tensor([0.5, -0.25]).view(1, 2, 1, 1).expand(1, 2, 10, 20)
    found = MotionConvention(True, (-1, 1), "NDC (-1..1)").to_pixels(stored)
    # y first: x is -0.25, of the other sign 0.25, times half of 20; y is 0.5 times half of 10
    torch.testing.assert_close(found[0, :, 0, 0], torch.tensor([2.5, 2.5]))
    torch.testing.assert_close(FORMAT_V1.to_pixels(stored), stored)
