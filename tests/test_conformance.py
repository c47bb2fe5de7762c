"""What every installed method must do: a new one is tested by being installed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import FrozenInstanceError, dataclass, field, fields, is_dataclass, replace
from functools import cache
from itertools import chain, zip_longest

import pytest
import torch
from torch import Tensor

from rlbench import registry
from rlbench.frames import Clip, Frame, Reference, Size, View
from rlbench.memory import MemoryClip
from rlbench.method import Method
from rlbench.procedural import procedural
from rlbench.run import Shown, run_clip
from rlbench.sampling import Samples, StoredPool

ODD = Size(1, 77, 123)  # divides by nothing that a network halves by
FRAMES = 3  # one without history, one with, and one whose history had history
METHODS = [
    name
    for family in registry.names("methods")
    if not registry.broken("methods", family)
    for name in registry.family(family).names()
]
every_method = pytest.mark.parametrize("name", METHODS)


@cache
def built(name: str) -> Method:
    """The method on the CPU; learned ones with seeded weights, for no claim here is of quality."""
    return registry.method(name, "cpu", "random" if registry.variant(name).learned else None)


def budget(name: str) -> float:
    """A budget that leaves pixels without a sample where the method allows that."""
    low, high = registry.variant(name).traits.spp
    return min(max(low, 0.6), high)


def clip(seed: int = 3, size: Size = ODD, **asked: object) -> MemoryClip:
    return procedural(seed, size, **{"frames": FRAMES, **asked})


@cache
def shown(name: str) -> list[Shown]:
    return list(run_clip(built(name), clip(), budget(name)))


def images(name: str, over: Clip, spp: float | None = None) -> Tensor:
    spp = budget(name) if spp is None else spp
    return torch.stack([each.image for each in run_clip(built(name), over, spp)])


@pytest.mark.parametrize("family", registry.names("methods"))
def test_every_installed_family_can_be_loaded(family):
    assert registry.broken("methods", family) is None


@every_method
def test_it_is_built_with_the_traits_that_its_family_declares(name):
    assert built(name).traits == registry.variant(name).traits


@every_method
def test_it_buys_its_budget_to_the_sample(name):
    bought = [int(each.samples.counts.sum()) for each in shown(name)]
    assert bought == [round(budget(name) * ODD.h * ODD.w)] * FRAMES


@every_method
def test_a_second_run_is_equal_bit_for_bit(name):
    again = images(name, clip())
    assert torch.equal(again, torch.stack([each.image for each in shown(name)]))


@every_method
def test_neither_reference_nor_unbought_samples_leak(name):
    first = shown(name)
    poisoned = [_poison(each) for each in first]
    again = images(name, MemoryClip("poisoned", "procedural", "", poisoned))
    assert torch.equal(again, torch.stack([each.image for each in first]))


@every_method
def test_images_are_finite_linear_radiance_in_single_precision(name):
    for each in shown(name):
        assert each.image.shape == (1, 3, ODD.h, ODD.w)
        assert each.image.dtype == torch.float32
        assert torch.isfinite(each.image).all()


@every_method
def test_densities_are_finite_and_not_negative(name):
    watched = Watched(built(name))
    list(run_clip(watched, clip(), budget(name)))
    assert len(watched.densities) == FRAMES * len(built(name).traits.passes)
    densities = torch.stack(watched.densities)
    assert torch.isfinite(densities).all()
    assert (densities >= 0).all()


@every_method
def test_a_method_that_does_not_adapt_wants_all_pixels_alike(name):
    if built(name).traits.adapts:
        pytest.skip("it adapts")
    watched = Watched(built(name))
    list(run_clip(watched, clip(), budget(name)))
    assert all(float(density.max() - density.min()) == 0 for density in watched.densities)


@every_method
def test_it_reads_exactly_the_buffers_that_it_declares(name):
    watched = Watched(built(name))
    list(run_clip(watched, clip(), budget(name)))
    assert watched.read == built(name).traits.needs


@every_method
def test_clips_advanced_in_turn_do_not_touch_each_other(name):
    alone = [images(name, clip(seed)) for seed in (3, 8)]
    runs = [run_clip(built(name), clip(seed), budget(name)) for seed in (3, 8)]
    turns = list(chain.from_iterable(zip_longest(*runs)))
    for i in range(2):
        assert torch.equal(torch.stack([each.image for each in turns[i::2]]), alone[i])


@every_method
def test_it_is_frozen(name):
    method = built(name)
    assert is_dataclass(method)
    with pytest.raises(FrozenInstanceError):
        setattr(method, fields(method)[0].name, None)


@every_method
@pytest.mark.parametrize("i", [0, 1])
def test_two_clips_at_once_are_as_each_alone(name, i):
    pair = clip(3, ODD._replace(n=2))
    both = Watched(built(name))
    together = torch.cat([each.image[i : i + 1] for each in run_clip(both, pair, budget(name))])
    # the last bit of a density decides counts, so the clip alone is given those of the pair
    alone = Replayed(built(name), [counts[i : i + 1] for counts in both.counts])
    single = MemoryClip("one", "procedural", "", [_only(frame, i) for frame in pair])
    apart = torch.cat([each.image for each in run_clip(alone, single, budget(name))])

    # convolutions add in another order for another batch: float32 through some 20 layers
    close = {"rtol": 1e-3, "atol": 1e-3}
    torch.testing.assert_close(together, apart, **close)
    wished = [density[i : i + 1] for density in both.densities]
    torch.testing.assert_close(torch.cat(wished), torch.cat(alone.densities), **close)


@every_method
def test_a_clip_that_stands_still_needs_no_motion(name):
    still = clip(static=True)
    assert torch.isfinite(images(name, still)).all()


@every_method
def test_where_another_shot_begins_it_remembers_nothing(name):
    *before, last = clip()
    away = torch.tensor([-2.0 * ODD.w, -2.0 * ODD.h]).view(1, 2, 1, 1)
    motion = away.expand_as(last.view.buffers["motion"])
    cut = replace(last, view=View({**last.view.buffers, "motion": motion}))
    after, fresh = (MemoryClip("cut", "procedural", "", some) for some in ([*before, cut], [cut]))
    assert torch.equal(images(name, after)[-1], images(name, fresh)[0])


@every_method
def test_a_pool_may_hold_fewer_samples_than_eight(name):
    spp = max(1.0, registry.variant(name).traits.spp[0])
    assert torch.isfinite(images(name, clip(pool_spp=2), spp)).all()


@every_method
def test_a_method_with_no_lower_limit_runs_without_a_sample(name):
    if registry.variant(name).traits.spp[0] > 0:
        pytest.skip("it asks for samples")
    assert torch.isfinite(images(name, clip(), 0.0)).all()


@dataclass(frozen=True)
class Watched:
    """A method, and what it read and wished for."""

    method: Method
    read: set[str] = field(default_factory=set)
    densities: list[Tensor] = field(default_factory=list)
    counts: list[Tensor] = field(default_factory=list)  # after each pass

    @property
    def traits(self):
        return self.method.traits

    def start(self, size: Size):
        return self.method.start(size)

    def plan(self, view: View, samples: Samples, state):
        if len(self.densities) % len(self.traits.passes):  # not the first pass of its frame
            self.counts.append(samples.counts)
        self.densities.append(self.method.plan(self._watch(view), samples, state))
        return self.densities[-1]

    def denoise(self, view: View, samples: Samples, state):
        self.counts.append(samples.counts)
        return self.method.denoise(self._watch(view), samples, state)

    def _watch(self, view: View) -> View:
        return replace(view, buffers=_Read(view.buffers, self.read))


@dataclass(frozen=True)
class Replayed:
    """A method that is given the counts written down for it, whatever it wishes for."""

    method: Method
    counts: list[Tensor]
    densities: list[Tensor] = field(default_factory=list)

    @property
    def traits(self):
        return replace(self.method.traits, adapts=True)  # to the counts

    def start(self, size: Size):
        return self.method.start(size)

    def plan(self, view: View, samples: Samples, state):
        self.densities.append(self.method.plan(view, samples, state))
        return self.counts[len(self.densities) - 1].double()

    def denoise(self, view: View, samples: Samples, state):
        return self.method.denoise(view, samples, state)


@dataclass(frozen=True)
class _Read(Mapping[str, Tensor]):
    buffers: Mapping[str, Tensor]
    read: set[str]

    def __getitem__(self, key: str) -> Tensor:
        self.read.add(key)
        return self.buffers[key]

    def __contains__(self, key: object) -> bool:
        return key in self.buffers

    def __iter__(self) -> Iterator[str]:
        return iter(self.buffers)

    def __len__(self) -> int:
        return len(self.buffers)


def _poison(each: Shown) -> Frame:
    """The frame with NaN for its reference and for every sample that was not bought of it."""
    frame, nan = each.frame, float("nan")
    radiance = frame.pool.radiance.where(each.samples.filled, nan)
    halves = torch.full_like(frame.reference.a, nan)
    return replace(
        frame, pool=StoredPool(radiance, frame.pool.keys), reference=Reference(halves, halves)
    )


def _only(frame: Frame, i: int) -> Frame:
    """One clip of a batch."""
    part = slice(i, i + 1)
    buffers = {key: buffer[part] for key, buffer in frame.view.buffers.items()}
    return Frame(
        frame.index,
        replace(frame.view, buffers=buffers),
        StoredPool(frame.pool.radiance[part], frame.pool.keys[part]),
        Reference(frame.reference.a[part], frame.reference.b[part]),
    )
