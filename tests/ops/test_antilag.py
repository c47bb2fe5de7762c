"""Antilag: chance is kept, a change is rejected, and the image is better for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from methods.ours import VARIANTS
from methods.ours.method import build
from methods.ours.train import training_task
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, Reference, Size, StoredPool
from rlbench.ops.accumulation import AccumulatedRadiance
from rlbench.ops.antilag import (
    CELL,
    DARK_RADIANCE,
    MIN_PIXELS,
    NOISE_ERRORS,
    WINDOWS,
    history_confidence,
    relative_change,
)
from rlbench.ops.color import luminance
from rlbench.ops.transfer import log_forward
from rlbench.run import run_clip


def radiance(samples: Tensor) -> AccumulatedRadiance:
    """Accumulated radiance of grey samples [s 1 h w]."""
    spp = torch.full_like(samples[:1], len(samples))
    return AccumulatedRadiance(
        samples.mean(0, True).expand(-1, 3, -1, -1), samples.square().mean(0, True), spp
    )


def image(value: Tensor | float, side: int = 64) -> Tensor:
    """A grey previous image of this radiance, in log transfer."""
    return log_forward(torch.as_tensor(value).expand(1, 3, side, side))


EVEN = image(1.0)


def noisy(count: int, side: int = 64, seed: int = 0, rare: float = 0.1) -> Tensor:
    """Samples of mean 1, of which a share `rare` is bright and the others are black."""
    generator = torch.Generator().manual_seed(seed)
    return (torch.rand(count, 1, side, side, generator=generator) < rare).float() / rare


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("rare", [0.5, 0.1, 0.01])
def test_chance_is_rarely_mistaken_for_a_change(count, rare):
    """At two standard errors and three windows, even if one sample in a hundred is bright."""
    share = history_confidence(
        radiance(noisy(16, rare=rare)), radiance(noisy(count, seed=1, rare=rare)), EVEN
    )
    assert share.mean() > 0.95


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_the_history_of_a_switched_light_is_rejected(factor):
    share = history_confidence(radiance(noisy(16)), radiance(factor * noisy(4, seed=1)), EVEN)
    assert share.mean() < 0.01


def test_a_change_in_one_half_of_the_image_keeps_the_history_of_the_other():
    after = noisy(4, seed=1, rare=0.5)
    after[..., :32] /= 8
    share = history_confidence(radiance(noisy(16, rare=0.5)), radiance(after), EVEN)[0, 0]
    # the largest window reaches 26 pixels, but unchanged pixels dilute the change in it
    assert share[:, :24].mean() < 0.01
    assert share[:, 60:].mean() > 0.9


def test_history_that_goes_dark_beside_a_lamp_that_stays_on_is_rejected_too():
    """All windows around these pixels contain part of the lamp, which hides the change."""
    lamp, beside = torch.zeros(2, 1, 1, 64, 64, dtype=torch.bool)
    lamp[..., 28:36, 28:36], beside[..., 25:39, 25:39] = True, True
    before, after = noisy(16, rare=0.5), noisy(4, seed=1, rare=0.5)
    old = radiance(torch.where(lamp, 500 * before, before))
    new = radiance(torch.where(lamp, 500 * after, after / 8))
    beside &= ~lamp
    assert history_confidence(old, new, image(torch.where(lamp, 500.0, 1.0)))[beside].mean() < 0.05
    assert history_confidence(old, new, EVEN)[beside].mean() > 0.5  # with equal weights


def test_history_is_kept_where_either_side_has_no_samples():
    old, new = radiance(noisy(16)), radiance(noisy(4) / 8)
    none = torch.zeros_like(new.accumulated_spp)
    assert (history_confidence(old._replace(accumulated_spp=none), new, EVEN) == 1).all()
    assert (history_confidence(old, new._replace(accumulated_spp=none), EVEN) == 1).all()


def by_loops(
    old: AccumulatedRadiance, new: AccumulatedRadiance, image_values: np.ndarray
) -> np.ndarray:
    """The relative change of each cell, from the pixels of its windows."""
    h, w = new.accumulated_spp.shape[-2:]
    both = ((old.accumulated_spp > 0) & (new.accumulated_spp > 0))[0, 0].numpy()
    scale = 1 / (image_values + DARK_RADIANCE)
    then, now = (luminance(x.mean)[0, 0].double().numpy() * scale for x in (old, new))
    square = old.second_moment[0, 0].double().numpy() * scale**2
    counts = [x.accumulated_spp[0, 0].double().numpy() for x in (old, new)]
    largest = np.zeros((-(-h // CELL), -(-w // CELL)))
    for i, j in np.ndindex(largest.shape):
        for side in WINDOWS:
            reach = side // 2
            top, left = max(0, i - reach) * CELL, max(0, j - reach) * CELL
            at = np.s_[top : (i + reach + 1) * CELL, left : (j + reach + 1) * CELL]
            used = both[at]
            if used.sum() <= MIN_PIXELS:
                continue
            a, b = then[at][used], now[at][used]
            variance = np.maximum(square[at][used] - a**2, 0)
            predicted = (variance / counts[0][at][used] + variance / counts[1][at][used]).mean()
            error = np.sqrt(max(np.var(b - a), predicted) / used.sum())
            change = max(abs((b - a).mean()) - NOISE_ERRORS * error, 0) / max(
                a.mean(), b.mean(), 1e-4
            )
            largest[i, j] = max(largest[i, j], change)
    return largest


@pytest.mark.parametrize(("h", "w"), [(32, 32), (30, 41)])
def test_relative_changes_equal_those_of_loops_over_pixels(h, w):
    """Some pixels have no new samples. 1e-4: float32 sums against float64."""
    old, new = radiance(noisy(8, 64, rare=0.5)), radiance(noisy(2, 64, seed=2, rare=0.5) * 0.8)
    holes = torch.rand(new.accumulated_spp.shape, generator=torch.Generator().manual_seed(3)) < 0.5
    old, new = (
        AccumulatedRadiance(*(x[..., :h, :w] for x in y))
        for y in (old, new._replace(accumulated_spp=new.accumulated_spp * holes))
    )
    previous = torch.rand(h, w, generator=torch.Generator().manual_seed(4)) + 0.5
    expected = by_loops(old, new, previous.double().numpy())
    assert np.allclose(
        relative_change(old, new, log_forward(previous.expand(1, 3, -1, -1)))[0, 0],
        expected,
        rtol=0,
        atol=1e-4,
    )
    assert 0.02 < expected.mean() < 0.3


def dimmed(frame: Frame, factor: float) -> Frame:
    assert isinstance(frame.pool, StoredPool)
    pool, reference = frame.pool, frame.reference
    return replace(
        frame,
        pool=StoredPool(pool.radiance * factor, pool.rounding_seeds),
        reference=Reference(reference.half_a * factor, reference.half_b * factor),
    )


def test_after_a_light_is_switched_ours_shows_the_new_light():
    """With the shipped weights: better in the first frame after it, and no worse before."""
    frames = list(procedural_clip(seed=3, size=Size(1, 64, 64), frames=4))
    clip = InMemoryClip(
        "switched", "test", "", [dimmed(f, 4.0 if f.index < 3 else 1.0) for f in frames]
    )
    errors = {}
    for variant in ("", "lag"):
        results = run_clip(build(variant, torch.device("cpu"), None), clip, 4.0)
        errors[variant] = [
            float((f.image - f.frame.reference.mean).square().mean()) for f in results
        ]
    assert errors[""][3] < 0.1 * errors["lag"][3]
    assert max(errors[""][:3]) < 1.2 * max(errors["lag"][:3])


def test_training_rejects_no_history():
    """No light is switched in training clips; the shipped weights were trained in this way."""
    method = training_task("A2", torch.device("cpu"), seed=0).method
    assert not method.config.antilag
    assert not method.accumulator.antilag
    assert VARIANTS["A2"].antilag
    shipped = build("A2", torch.device("cpu"), "random")
    assert shipped.accumulator.antilag


@pytest.mark.parametrize(("pixels", "is_kept"), [(3, True), (4, False)])
def test_a_window_of_three_sampled_pixels_says_nothing(pixels, is_kept):
    """Light goes out without any noise; only some neighbouring pixels are sampled."""
    known = torch.zeros(1, 1, 64, 64)
    known[..., 32, 32 : 32 + pixels] = 1.0
    old = AccumulatedRadiance(torch.ones(1, 3, 64, 64), torch.ones(1, 1, 64, 64), 16 * known)
    new = AccumulatedRadiance(torch.zeros(1, 3, 64, 64), torch.zeros(1, 1, 64, 64), known)
    assert bool((history_confidence(old, new, EVEN) == 1).all()) == is_kept
