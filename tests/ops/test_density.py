"""The exponential of a map: what may be added to it, and how steep it may be."""

from __future__ import annotations

import pytest
import torch

from rlbench.ops.density import bounded_exp_density


def drawn() -> torch.Tensor:
    return torch.randn(2, 1, 9, 11, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("shift", [-40.0, 3.0, 1e3])
def test_a_constant_added_to_the_map_changes_nothing(shift: float) -> None:
    # the sum is rounded to 1e-4 at a thousand
    torch.testing.assert_close(
        bounded_exp_density(drawn() + shift), bounded_exp_density(drawn()), rtol=2e-4, atol=0
    )


def test_ratios_of_a_faint_map_are_those_of_exponentials() -> None:
    faint = drawn() / 100
    ratios, wanted = (x / x[..., :1, :1] for x in (bounded_exp_density(faint), faint.exp()))
    torch.testing.assert_close(ratios, wanted, rtol=1e-4, atol=0)  # its rms is 1/150 of STEEP


@pytest.mark.parametrize("steepness", [1.0, 1e3, 1e6, 1e12])
def test_a_map_of_any_scale_keeps_its_order_and_can_learn(steepness: float) -> None:
    wish = (steepness * drawn()).requires_grad_()
    density = bounded_exp_density(wish)
    assert torch.equal(density[0].flatten().argsort(), wish[0].flatten().argsort())
    (density.log() * drawn().square()).sum().backward()
    assert (wish.grad * steepness).abs().median() > 0.05  # as a share of the map's own scale


def test_one_pixel_far_above_the_others_does_not_stop_them() -> None:
    wish = drawn()
    wish[..., 4, 5] = 1e6
    wish.requires_grad_()
    density = bounded_exp_density(wish)
    assert density.min() > 0.002
    (density.log() * drawn().square()).sum().backward()
    assert (wish.grad != 0).float().mean() > 0.9


@pytest.mark.parametrize("steepness", [0.0, 1.0, 1e4])
def test_the_largest_is_one_and_none_is_zero(steepness: float) -> None:
    density = bounded_exp_density(steepness * drawn())
    assert torch.equal(density.amax((1, 2, 3)), torch.ones(2))
    assert density.min() > 0
