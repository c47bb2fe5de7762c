"""The exponential of a map: what may be added to it, and how steep it may be."""

from __future__ import annotations

import pytest
import torch

from rlbench.ops.density import exponential


def drawn() -> torch.Tensor:
    return torch.randn(2, 1, 9, 11, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("shift", [-40.0, 3.0, 1e3])
def test_a_constant_added_to_the_map_changes_nothing(shift: float) -> None:
    # the sum is rounded to 1e-4 at a thousand
    torch.testing.assert_close(
        exponential(drawn() + shift), exponential(drawn()), rtol=2e-4, atol=0
    )


def test_ratios_are_those_of_exponentials() -> None:
    density, wish = exponential(drawn()), drawn()
    # float32 through one exponential
    torch.testing.assert_close(density / density[..., :1, :1], (wish - wish[..., :1, :1]).exp())


@pytest.mark.parametrize("steepness", [0.0, 1.0, 1e4])
def test_the_largest_is_one_and_none_is_zero(steepness: float) -> None:
    density = exponential(steepness * drawn())
    assert torch.equal(density.amax((1, 2, 3)), torch.ones(2))
    assert density.min() > 0
