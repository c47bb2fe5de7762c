"""The gradient of a density: relaxed counts, the surrogate of samples, and several passes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest
import torch
from torch import Tensor

from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.family import Traits
from rlbench.frames import Frame, GBuffer, Reference, Samples, Size, StoredPool
from rlbench.run import unroll
from rlbench.sampling import allocate_counts
from rlbench.training import SurrogateGradient, kuznetsov_gradient, relaxed_counts

SIZE = Size(1, 12, 16)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def ones(*shape: int) -> Tensor:
    return torch.ones(*shape, dtype=torch.int64)


def frame_with(reference: Tensor) -> Frame:
    """A frame of which only the reference matters."""
    pool = StoredPool(reference[:, None], (0,))
    return Frame(0, GBuffer({}), pool, Reference(reference, reference))


@pytest.mark.parametrize("uneven", [0, 3])
def test_counts_are_relaxed_counts_rounded(uneven: int) -> None:
    density = (4 * random(1, 1, 20, 20)).exp() / 55
    low = 1 + (uneven * random(1, 1, 20, 20, seed=1)).long()  # as after a first pass
    counts = allocate_counts(density, 3 * 400, low, 8, rounding_seeds=(0,))
    relaxed = relaxed_counts(density, 3.0, low, 8)
    assert float(relaxed.mean()) == pytest.approx(3.0, rel=1e-5)  # float32 sum of 400
    assert ((relaxed - counts).abs() < 1 + 1e-4).all()


def test_relaxed_counts_do_not_depend_on_the_scale_of_a_density() -> None:
    density, low = random(1, 1, 12, 16).clamp_min(1e-3), ones(1, 1, 12, 16)
    # the same bisection from the same bounds: its last step is 1e-8 of the multiplier
    torch.testing.assert_close(
        relaxed_counts(density / 7, 2.5, low, 8),
        relaxed_counts(density, 2.5, low, 8),
        rtol=1e-5,
        atol=0,
    )


@pytest.mark.parametrize("low", [0, 1, 2])
def test_relaxed_counts_have_the_gradient_of_finite_differences(low: int) -> None:
    density = random(2, 1, 3, 4).double().mul(3).exp().div(25).requires_grad_()
    min_counts = ones(2, 1, 3, 4)
    min_counts[..., :2] = low
    # the multiplier is bisected to 1e-8, which the step of 1e-4 turns into 1e-4
    assert torch.autograd.gradcheck(
        lambda d: relaxed_counts(d, 2.5, min_counts, 8), density, eps=1e-4, atol=1e-3, rtol=1e-3
    )


def test_relaxed_counts_at_the_minimum_have_no_gradient() -> None:
    density = random(1, 1, 4, 4).requires_grad_()
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
    relaxed = counts.float().requires_grad_()
    reference = torch.ones(1, 3, 1, pixels)
    result = kuznetsov_gradient(samples, relaxed, frame_with(reference))
    (result.mean - reference).square().mean(1).sum().backward()
    expected = -2 * deviation**2 / count**2
    error = relaxed.grad.std() / pixels**0.5
    assert abs(relaxed.grad.mean() - expected) < 4 * error


@dataclass(frozen=True)
class LearnedDensity:
    """Shows the mean; its densities are learned, one for each pass."""

    traits: Traits
    weights: tuple[Tensor, ...]
    totals: list[int] = field(default_factory=list)  # of samples drawn before each plan

    def start(self, size: Size) -> None:
        self.totals.clear()

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Tensor:
        self.totals.append(int(samples.counts.sum()))
        return self.weights[(len(self.totals) - 1) % len(self.weights)].exp()

    def denoise(self, gbuffer: GBuffer, samples: Samples, state: None) -> tuple[Tensor, None]:
        return samples.mean, None


def learned_density(**traits: object) -> LearnedDensity:
    passes = Traits(adaptive=True, min_samples=1, **traits).passes
    weights = tuple(-random(1, 1, 12, 16, seed=i) for i in range(len(passes)))
    return LearnedDensity(
        Traits(adaptive=True, min_samples=1, **traits),
        tuple(each.requires_grad_() for each in weights),
    )


def images_with_gradient(method: LearnedDensity, clip: InMemoryClip, spp: float) -> list[Tensor]:
    wrapped = SurrogateGradient(method, iter(clip), spp)
    return [result.image for result in unroll(wrapped, clip, spp)]


PASSES = pytest.mark.parametrize(
    "traits",
    [{}, {"pilot_spp": 1.0}, {"passes": (0.5, 1.0)}, {"pilot_spp": 1.0, "passes": (0.75, 1.0)}],
    ids=["one pass", "pilot", "two passes", "pilot and two passes"],
)


@PASSES
def test_the_gradient_changes_no_value(traits: dict[str, object]) -> None:
    clip, method = procedural_clip(3, SIZE, frames=2), learned_density(**traits)
    plain = [result.image for result in unroll(method, clip, 3.0)]
    assert all(
        torch.equal(a, b)
        for a, b in zip(plain, images_with_gradient(method, clip, 3.0), strict=True)
    )


@PASSES
def test_only_the_density_of_the_last_pass_gets_a_gradient(traits: dict[str, object]) -> None:
    clip, method = procedural_clip(3, SIZE, frames=1), learned_density(**traits)
    (image,) = images_with_gradient(method, clip, 3.0)
    image.sum().backward()
    *earlier, last = method.weights
    assert last.grad.abs().sum() > 0
    assert [weights.grad for weights in earlier] == [None] * len(earlier)


def test_the_mean_that_gets_a_gradient_includes_the_pilot() -> None:
    """With one free pixel the gradient is (T - I) / n for the mean I of all n samples."""
    reference = torch.full((1, 3, 1, 2), 2.0)
    radiance = torch.arange(1.0, 9.0).view(1, 8, 1, 1, 1).expand(1, 8, 3, 1, 2)
    frame = Frame(0, GBuffer({}), StoredPool(radiance, (0,)), Reference(reference, reference))
    counts: list[Tensor] = []

    def record(samples: Samples, relaxed: Tensor, frame: Frame) -> Samples:
        counts.append(relaxed)
        relaxed.retain_grad()
        return kuznetsov_gradient(samples, relaxed, frame)

    method = LearnedDensity(
        Traits(adaptive=True, min_samples=1, pilot_spp=1.0),
        (torch.tensor([[[[0.0, -1.0]]]], requires_grad=True),),
    )
    clip = InMemoryClip("two pixels", "two pixels", "", [frame])
    (result,) = unroll(SurrogateGradient(method, iter(clip), 3.0, record), clip, 3.0)
    result.image.sum().backward()
    n = result.samples.counts.flatten()
    mean = (n + 1) / 2  # of 1, 2, .. n
    torch.testing.assert_close(counts[0].grad.flatten(), 3 * (2 - mean) / n)


def test_a_pixel_that_the_pilot_filled_beyond_its_count_gets_no_gradient() -> None:
    low = ones(1, 1, 1, 4)
    low[..., 0] = 6
    density = torch.tensor([[[[0.1, 1.0, 0.5, 0.2]]]], requires_grad=True)
    relaxed = relaxed_counts(density, 3.0, low, 8)
    assert relaxed[..., 0].item() == 6
    (gradient,) = torch.autograd.grad(relaxed[..., 1].sum(), density)
    assert float(gradient[..., 0]) == 0


def test_relaxed_counts_do_not_exceed_the_methods_maximum() -> None:
    method = learned_density()
    capped = replace(method, traits=replace(method.traits, max_samples=3))
    counts: list[Tensor] = []

    def record(samples: Samples, relaxed: Tensor, frame: Frame) -> Samples:
        counts.append(relaxed)
        return samples

    clip = procedural_clip(3, SIZE, frames=1)
    list(unroll(SurrogateGradient(capped, iter(clip), 2.8, record), clip, 2.8))
    assert counts[0].max().item() == 3
