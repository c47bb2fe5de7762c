"""G-buffers give declared buffers only; a reference is the mean of its halves."""

from __future__ import annotations

import pytest
import torch

from rlbench.frames import BUFFERS, GBuffer, Reference

CHANNELS = {"albedo": 3, "normal": 3, "depth": 1, "motion": 2}
GBUFFER = GBuffer({name: torch.full((1, c, 4, 5), float(c)) for name, c in CHANNELS.items()})


@pytest.mark.parametrize("name", BUFFERS)
def test_a_declared_buffer_is_read(name):
    assert torch.equal(getattr(GBUFFER.select(frozenset({name})), name), GBUFFER.buffers[name])


@pytest.mark.parametrize("name", BUFFERS)
def test_reading_an_undeclared_buffer_is_an_error_that_lists_the_others(name):
    others = [each for each in BUFFERS if each != name]
    message = f"'{name}' was read but not declared; declared: {', '.join(others)}"
    with pytest.raises(LookupError, match=message):
        getattr(GBUFFER.select(frozenset(others)), name)


def test_motion_of_a_static_clip_is_none():
    assert GBuffer({}, static=True).select(frozenset({"motion"})).motion is None


def test_the_reference_is_the_mean_of_its_halves():
    a, b = torch.zeros(1, 3, 2, 2), torch.ones(1, 3, 2, 2)
    assert torch.equal(Reference(a, b).mean, torch.full((1, 3, 2, 2), 0.5))
