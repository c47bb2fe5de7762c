"""A view gives what was declared and nothing else; a reference is the mean of its halves."""

from __future__ import annotations

import pytest
import torch

from rlbench.frames import BUFFERS, GBuffer, Reference

CHANNELS = {"albedo": 3, "normal": 3, "depth": 1, "motion": 2}
VIEW = GBuffer({name: torch.full((1, c, 4, 5), float(c)) for name, c in CHANNELS.items()})


@pytest.mark.parametrize("name", BUFFERS)
def test_a_declared_buffer_is_read(name):
    assert torch.equal(getattr(VIEW.select(frozenset({name})), name), VIEW.buffers[name])


@pytest.mark.parametrize("name", BUFFERS)
def test_an_undeclared_buffer_is_refused(name):
    gbuffer = VIEW.select(frozenset(BUFFERS) - {name})
    with pytest.raises(LookupError, match=f"'{name}' was read but not declared"):
        getattr(gbuffer, name)


def test_the_refusal_says_what_there_is():
    with pytest.raises(LookupError, match="declared: depth"):
        _ = VIEW.select(frozenset({"depth"})).albedo


def test_where_nothing_moves_motion_is_none():
    assert GBuffer({}, static=True).motion is None


def test_narrowing_keeps_that_nothing_moves():
    assert GBuffer({}, static=True).select(frozenset({"motion"})).motion is None


def test_the_reference_is_the_mean_of_its_halves():
    a, b = torch.zeros(1, 3, 2, 2), torch.ones(1, 3, 2, 2)
    assert torch.equal(Reference(a, b).mean, torch.full((1, 3, 2, 2), 0.5))
