"""Normals from depth, and their rotation."""

from __future__ import annotations

import math

import pytest
import torch

from rlbench.apps.dumps.lint.checks import fit_depth
from rlbench.apps.dumps.lint.geometry import VIEW_DEPTH, fit_rotation


def test_depth_and_normals_give_the_field_of_view_of_the_camera(arrays):
    fit = fit_depth(arrays)[VIEW_DEPTH]
    gbuffer = math.degrees(2 * math.atan(0.5 / fit.focal))
    assert gbuffer == pytest.approx(60, abs=3)  # the search's last step is 5 % of the focal length


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_rotation_is_fitted_despite_outliers(mirror):
    generator = torch.Generator().manual_seed(0)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    turn = turn * torch.linalg.det(turn) * mirror
    source = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator), dim=1)
    target = source @ turn.T
    target[:100] = target[:100].roll(1, 0)
    torch.testing.assert_close(
        fit_rotation(source, target)[0], turn, atol=0.01, rtol=0
    )  # a fifth lies
