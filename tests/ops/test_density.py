"""The bounded exponential: invariance, faint maps, bounds, and gradients at any scale."""

from __future__ import annotations

import pytest
import torch

from rlbench.ops.density import bounded_exp_density


def random_logits() -> torch.Tensor:
    return torch.randn(2, 1, 9, 11, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("shift", [-40.0, 3.0, 1e3])
def test_adding_a_constant_changes_nothing(shift: float) -> None:
    # the sum is rounded to 1e-4 at a thousand
    torch.testing.assert_close(
        bounded_exp_density(random_logits() + shift),
        bounded_exp_density(random_logits()),
        rtol=2e-4,
        atol=0,
    )


def test_a_map_of_small_contrast_gives_the_ratios_of_exponentials() -> None:
    faint = random_logits() / 100
    ratios, expected = (x / x[..., :1, :1] for x in (bounded_exp_density(faint), faint.exp()))
    torch.testing.assert_close(ratios, expected, rtol=1e-4, atol=0)  # its rms is 1/150 of RMS_LIMIT


@pytest.mark.parametrize("steepness", [1.0, 1e3, 1e6, 1e12])
def test_a_map_of_any_scale_keeps_its_order_and_gets_gradients(steepness: float) -> None:
    logits = (steepness * random_logits()).requires_grad_()
    density = bounded_exp_density(logits)
    assert torch.equal(density[0].flatten().argsort(), logits[0].flatten().argsort())
    (density.log() * random_logits().square()).sum().backward()
    assert (logits.grad * steepness).abs().median() > 0.05  # relative to the scale of the map


def test_one_pixel_far_above_the_others_leaves_them_gradients() -> None:
    logits = random_logits()
    logits[..., 4, 5] = 1e6
    logits.requires_grad_()
    density = bounded_exp_density(logits)
    assert density.min() > 0.002
    (density.log() * random_logits().square()).sum().backward()
    assert (logits.grad != 0).float().mean() > 0.9


@pytest.mark.parametrize("steepness", [0.0, 1.0, 1e4])
def test_the_maximum_is_one_and_no_value_is_zero(steepness: float) -> None:
    density = bounded_exp_density(steepness * random_logits())
    assert torch.equal(density.amax((1, 2, 3)), torch.ones(2))
    assert density.min() > 0
