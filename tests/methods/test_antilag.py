"""Forgetting light that has changed: what is chance, what is not, and what it gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from methods.ours.accumulation import AccumulatedRadiance
from methods.ours.antilag import (
    CELL,
    ERRORS,
    FAINT,
    FEW,
    WINDOWS,
    history_confidence,
    relative_change,
)
from methods.ours.method import build
from methods.ours.train import trainer
from methods.ours.variants import VARIANTS
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural
from rlbench.frames import Frame, Reference, Size, StoredPool
from rlbench.ops.color import luminance
from rlbench.ops.transfer import log_forward
from rlbench.run import run_clip


def light(samples: Tensor) -> AccumulatedRadiance:
    """Of so many samples [s 1 h w] in each pixel, all of them grey."""
    weight = torch.full_like(samples[:1], len(samples))
    return AccumulatedRadiance(
        samples.mean(0, True).expand(-1, 3, -1, -1), samples.square().mean(0, True), weight
    )


def image(value: Tensor | float, side: int = 64) -> Tensor:
    """The last image, grey, of so much radiance, in log transfer."""
    return log_forward(torch.as_tensor(value).expand(1, 3, side, side))


EVEN = image(1.0)


def noisy(count: int, side: int = 64, seed: int = 0, rare: float = 0.1) -> Tensor:
    """Samples of mean 1, of which the share `rare` is bright and the others are dark."""
    generator = torch.Generator().manual_seed(seed)
    return (torch.rand(count, 1, side, side, generator=generator) < rare).float() / rare


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("rare", [0.5, 0.1, 0.01])
def test_chance_is_hardly_taken_for_a_change(count, rare):
    """At two standard errors and three windows; even where one sample in a hundred is bright."""
    share = history_confidence(
        light(noisy(16, rare=rare)), light(noisy(count, seed=1, rare=rare)), EVEN
    )
    assert share.mean() > 0.95


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_a_light_that_is_switched_is_forgotten(factor):
    share = history_confidence(light(noisy(16)), light(factor * noisy(4, seed=1)), EVEN)
    assert share.mean() < 0.01


def test_what_changes_in_one_half_is_kept_in_the_other():
    after = noisy(4, seed=1, rare=0.5)
    after[..., :32] /= 8
    share = history_confidence(light(noisy(16, rare=0.5)), light(after), EVEN)[0, 0]
    # the largest window reaches 26 pixels, but what it doubts is diluted by what has not changed
    assert share[:, :24].mean() < 0.01
    assert share[:, 60:].mean() > 0.9


def test_what_goes_dark_beside_a_lamp_that_stays_is_forgotten_too():
    """All windows around what is beside it hold some of the lamp, which hides the change."""
    lamp, beside = torch.zeros(2, 1, 1, 64, 64, dtype=torch.bool)
    lamp[..., 28:36, 28:36], beside[..., 25:39, 25:39] = True, True
    before, after = noisy(16, rare=0.5), noisy(4, seed=1, rare=0.5)
    old = light(torch.where(lamp, 500 * before, before))
    new = light(torch.where(lamp, 500 * after, after / 8))
    beside &= ~lamp
    assert history_confidence(old, new, image(torch.where(lamp, 500.0, 1.0)))[beside].mean() < 0.05
    assert history_confidence(old, new, EVEN)[beside].mean() > 0.5  # were all counted alike


def test_where_either_has_no_samples_there_is_no_doubt():
    old, new = light(noisy(16)), light(noisy(4) / 8)
    none = torch.zeros_like(new.accumulated_spp)
    assert (history_confidence(old._replace(weight=none), new, EVEN) == 1).all()
    assert (history_confidence(old, new._replace(weight=none), EVEN) == 1).all()


def by_loops(old: AccumulatedRadiance, new: AccumulatedRadiance, shown: np.ndarray) -> np.ndarray:
    """The doubt of each cell, from the pixels of its windows."""
    h, w = new.accumulated_spp.shape[-2:]
    both = ((old.accumulated_spp > 0) & (new.accumulated_spp > 0))[0, 0].numpy()
    scale = 1 / (shown + FAINT)
    then, now = (luminance(x.mean)[0, 0].double().numpy() * scale for x in (old, new))
    square = old.second_moment[0, 0].double().numpy() * scale**2
    counts = [x.accumulated_spp[0, 0].double().numpy() for x in (old, new)]
    most = np.zeros((-(-h // CELL), -(-w // CELL)))
    for i, j in np.ndindex(most.shape):
        for side in WINDOWS:
            reach = side // 2
            top, left = max(0, i - reach) * CELL, max(0, j - reach) * CELL
            at = np.s_[top : (i + reach + 1) * CELL, left : (j + reach + 1) * CELL]
            used = both[at]
            if used.sum() <= FEW:
                continue
            a, b = then[at][used], now[at][used]
            spread = np.maximum(square[at][used] - a**2, 0)
            foretold = (spread / counts[0][at][used] + spread / counts[1][at][used]).mean()
            error = np.sqrt(max(np.var(b - a), foretold) / used.sum())
            doubt = max(abs((b - a).mean()) - ERRORS * error, 0) / max(a.mean(), b.mean(), 1e-4)
            most[i, j] = max(most[i, j], doubt)
    return most


@pytest.mark.parametrize(("h", "w"), [(32, 32), (30, 41)])
def test_doubts_are_those_of_loops_over_pixels(h, w):
    """Some pixels have no new samples. 1e-4: float32 sums against float64."""
    old, new = light(noisy(8, 64, rare=0.5)), light(noisy(2, 64, seed=2, rare=0.5) * 0.8)
    holes = torch.rand(new.accumulated_spp.shape, generator=torch.Generator().manual_seed(3)) < 0.5
    old, new = (
        AccumulatedRadiance(*(x[..., :h, :w] for x in y))
        for y in (old, new._replace(weight=new.accumulated_spp * holes))
    )
    shown = torch.rand(h, w, generator=torch.Generator().manual_seed(4)) + 0.5
    wanted = by_loops(old, new, shown.double().numpy())
    assert np.allclose(
        relative_change(old, new, log_forward(shown.expand(1, 3, -1, -1)))[0, 0],
        wanted,
        rtol=0,
        atol=1e-4,
    )
    assert 0.02 < wanted.mean() < 0.3


def dimmed(frame: Frame, factor: float) -> Frame:
    assert isinstance(frame.pool, StoredPool)
    pool, reference = frame.pool, frame.reference
    return replace(
        frame,
        pool=StoredPool(pool.radiance * factor, pool.rounding_seeds),
        reference=Reference(reference.half_a * factor, reference.half_b * factor),
    )


def test_after_a_light_is_switched_ours_shows_the_new_one():
    """With the shipped weights; the first frame of the other light, and no loss before it."""
    frames = list(procedural(seed=3, size=Size(1, 64, 64), frames=4))
    clip = InMemoryClip(
        "switched", "test", "", [dimmed(f, 4.0 if f.index < 3 else 1.0) for f in frames]
    )
    errors = {}
    for variant in ("", "lag"):
        shown = run_clip(build(variant, torch.device("cpu"), None), clip, 4.0)
        errors[variant] = [float((s.image - s.frame.reference.mean).square().mean()) for s in shown]
    assert errors[""][3] < 0.1 * errors["lag"][3]
    assert max(errors[""][:3]) < 1.2 * max(errors["lag"][:3])


def test_training_forgets_nothing():
    """Its clips switch no light; shipped weights are of that training."""
    assert not trainer("A2", torch.device("cpu"), seed=0).method.config.antilag
    assert VARIANTS["A2"].antilag
