"""The gradient that reaches a density: shares, the pull towards the truth, and several passes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest
import torch
from torch import Tensor

from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural
from rlbench.family import Traits
from rlbench.frames import Frame, GBuffer, Reference, Samples, Size, StoredPool
from rlbench.run import unroll
from rlbench.sampling import allocate_counts
from rlbench.training.surrogate_gradient import (
    SurrogateGradient,
    kuznetsov_gradient,
    relaxed_counts,
)

SIZE = Size(1, 12, 16)


def drawn(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def ones(*shape: int) -> Tensor:
    return torch.ones(*shape, dtype=torch.int64)


def framed(truth: Tensor) -> Frame:
    """A frame of which only the truth matters."""
    return Frame(0, GBuffer({}), StoredPool(truth[:, None], (0,)), Reference(truth, truth))


def test_shares_are_what_spend_rounds() -> None:
    density = (4 * drawn(1, 1, 20, 20)).exp() / 55
    counts = allocate_counts(density, 2 * 400, ones(1, 1, 20, 20), 8, keys=(0,))
    due = relaxed_counts(density, 2.0, ones(1, 1, 20, 20), 8)
    assert float(due.mean()) == pytest.approx(2.0, rel=1e-5)  # float32 sum of 400
    assert ((due - counts).abs() < 1 + 1e-4).all()


def test_shares_over_uneven_holdings_are_what_spend_rounds() -> None:
    density = (4 * drawn(1, 1, 20, 20)).exp() / 55
    low = 1 + (3 * drawn(1, 1, 20, 20, seed=1)).long()  # as after a first pass
    counts = allocate_counts(density, 3 * 400, low, 8, keys=(0,))
    due = relaxed_counts(density, 3.0, low, 8)
    assert float(due.mean()) == pytest.approx(3.0, rel=1e-5)  # float32 sum of 400
    assert ((due - counts).abs() < 1 + 1e-4).all()


def test_shares_do_not_ask_for_the_scale_of_a_density() -> None:
    density, low = drawn(1, 1, 12, 16).clamp_min(1e-3), ones(1, 1, 12, 16)
    # the same bisection from the same bounds: its last step is 1e-8 of the multiplier
    torch.testing.assert_close(
        relaxed_counts(density / 7, 2.5, low, 8),
        relaxed_counts(density, 2.5, low, 8),
        rtol=1e-5,
        atol=0,
    )


@pytest.mark.parametrize("low", [0, 1, 2])
def test_shares_have_the_gradient_of_finite_differences(low: int) -> None:
    density = drawn(2, 1, 3, 4).double().mul(3).exp().div(25).requires_grad_()
    held = ones(2, 1, 3, 4)
    held[..., :2] = low
    # the multiplier is bisected to 1e-8, which the step of 1e-4 turns into 1e-4
    assert torch.autograd.gradcheck(
        lambda d: relaxed_counts(d, 2.5, held, 8), density, eps=1e-4, atol=1e-3, rtol=1e-3
    )


def test_shares_at_the_floor_have_no_gradient() -> None:
    density = drawn(1, 1, 4, 4).requires_grad_()
    relaxed_counts(density, 1.0, ones(1, 1, 4, 4), 8).square().sum().backward()
    assert torch.equal(density.grad, torch.zeros_like(density))


@pytest.mark.parametrize("count", [1, 2, 4])
def test_the_surrogate_is_twice_the_derivative_of_the_squared_error(count: int) -> None:
    """For the mean of s normal samples of variance v: E[2 (I - T) (T - I) / s] = -2 v / s^2."""
    deviation, pixels = 0.5, 200_000
    generator = torch.Generator().manual_seed(count)
    radiance = 1 + deviation * torch.randn(1, 8, 3, 1, pixels, generator=generator)
    counts = torch.full((1, 1, 1, pixels), count)
    samples = Samples(radiance.where(Samples(radiance, counts).valid_mask, 0.0), counts)
    due = counts.float().requires_grad_()
    truth = torch.ones(1, 3, 1, pixels)
    taught = kuznetsov_gradient(samples, due, framed(truth))
    (taught.mean - truth).square().mean(1).sum().backward()
    expected = -2 * deviation**2 / count**2
    error = due.grad.std() / pixels**0.5
    assert abs(due.grad.mean() - expected) < 4 * error


@dataclass(frozen=True)
class Learner:
    """Averages; asks for what its weights say, one set of weights for each pass."""

    traits: Traits
    weights: tuple[Tensor, ...]
    asked: list[int] = field(default_factory=list)  # samples at hand at each plan

    def start(self, size: Size) -> None:
        self.asked.clear()

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Tensor:
        self.asked.append(int(samples.counts.sum()))
        return self.weights[(len(self.asked) - 1) % len(self.weights)].exp()

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: None) -> tuple[Tensor, None]:
        return samples.mean, None


def learner(**traits: object) -> Learner:
    passes = Traits(adaptive=True, min_samples=1, **traits).passes
    weights = tuple(-drawn(1, 1, 12, 16, seed=i) for i in range(len(passes)))
    return Learner(
        Traits(adaptive=True, min_samples=1, **traits),
        tuple(each.requires_grad_() for each in weights),
    )


def taught(method: Learner, clip: InMemoryClip, spp: float) -> list[Tensor]:
    return [shown.image for shown in unroll(SurrogateGradient(method, iter(clip), spp), clip, spp)]


PASSES = pytest.mark.parametrize(
    "traits",
    [{}, {"pilot": 1.0}, {"passes": (0.5, 1.0)}, {"pilot": 1.0, "passes": (0.75, 1.0)}],
    ids=["one pass", "pilot", "two passes", "pilot and two passes"],
)


@PASSES
def test_teaching_changes_no_value(traits: dict[str, object]) -> None:
    clip, method = procedural(3, SIZE, frames=2), learner(**traits)
    plain = [shown.image for shown in unroll(method, clip, 3.0)]
    assert all(torch.equal(a, b) for a, b in zip(plain, taught(method, clip, 3.0), strict=True))


@PASSES
def test_what_the_last_pass_asked_for_is_taught(traits: dict[str, object]) -> None:
    clip, method = procedural(3, SIZE, frames=1), learner(**traits)
    (image,) = taught(method, clip, 3.0)
    image.sum().backward()
    *earlier, last = method.weights
    assert last.grad.abs().sum() > 0
    assert [weights.grad for weights in earlier] == [None] * len(earlier)


def test_the_mean_that_is_pulled_holds_the_pilot() -> None:
    """With one pixel free the slope is (T - I) / n for the mean I of all n samples."""
    truth = torch.full((1, 3, 1, 2), 2.0)
    radiance = torch.arange(1.0, 9.0).view(1, 8, 1, 1, 1).expand(1, 8, 3, 1, 2)
    frame = Frame(0, GBuffer({}), StoredPool(radiance, (0,)), Reference(truth, truth))
    seen: list[Tensor] = []

    def teach(samples: Samples, due: Tensor, frame: Frame) -> Samples:
        seen.append(due)
        due.retain_grad()
        return kuznetsov_gradient(samples, due, frame)

    method = Learner(
        Traits(adaptive=True, min_samples=1, pilot_spp=1.0),
        (torch.tensor([[[[0.0, -1.0]]]], requires_grad=True),),
    )
    clip = InMemoryClip("two pixels", "two pixels", "", [frame])
    (shown,) = unroll(SurrogateGradient(method, iter(clip), 3.0, teach), clip, 3.0)
    shown.image.sum().backward()
    counts = shown.samples.counts.flatten()
    mean = (counts + 1) / 2  # of 1, 2, .. n
    torch.testing.assert_close(seen[0].grad.flatten(), 3 * (2 - mean) / counts)


def test_a_pixel_that_the_pilot_filled_beyond_its_share_is_not_taught() -> None:
    low = ones(1, 1, 1, 4)
    low[..., 0] = 6
    density = torch.tensor([[[[0.1, 1.0, 0.5, 0.2]]]], requires_grad=True)
    due = relaxed_counts(density, 3.0, low, 8)
    assert due[..., 0].item() == 6
    (slope,) = torch.autograd.grad(due[..., 1].sum(), density)
    assert float(slope[..., 0]) == 0


def test_a_cap_bounds_what_is_due() -> None:
    method = learner()
    capped = replace(method, traits=replace(method.traits, max_samples=3))
    due: list[Tensor] = []

    def teach(samples: Samples, share: Tensor, frame: Frame) -> Samples:
        due.append(share)
        return samples

    clip = procedural(3, SIZE, frames=1)
    list(unroll(SurrogateGradient(capped, iter(clip), 2.8, teach), clip, 2.8))
    assert due[0].max().item() == 3
