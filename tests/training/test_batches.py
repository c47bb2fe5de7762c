"""What is drawn for training: crops that stay in place, turned and exposed as one; read ahead."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.stored import open_clip
from rlbench.ops.reprojection import reproject
from rlbench.training.batches import BatchError, Batches, prefetch, sample_budget
from tests.conftest import write_noise
from tests.procedural_folder import write_world


@pytest.fixture
def world(tmp_path: Path) -> Path:
    return write_world(tmp_path / "world", seed=3, side=64, frames=2)


def whole(folder: Path, index: int) -> InMemoryClip:
    """A draw of all pixels and frames of a clip of 64 x 64 pixels."""
    return Batches([folder], batch=1, crop=64, length=2, seed=0).sequence(index)


def error(before: Tensor, now: Tensor, motion: Tensor) -> float:
    """Median difference of a frame and the last one, moved here, where that is known."""
    moved, valid = reproject(before, motion)
    return float((moved - now).abs()[valid.expand_as(now)].median())


@pytest.mark.parametrize("index", range(8))  # of draws, turned in eight ways or fewer
def test_a_crop_stays_in_place_and_moves_as_its_motion_says(world, index):
    before, now = Batches([world], batch=1, crop=40, length=2, seed=0).sequence(index).frames
    told = error(before.gbuffer.albedo, now.gbuffer.albedo, now.gbuffer.motion)
    still = error(before.gbuffer.albedo, now.gbuffer.albedo, 0 * now.gbuffer.motion)
    assert told < still / 2  # blur of a texture, against its movement; turned wrongly: twice it


def test_draws_are_turned_in_many_ways(world):
    ways = set()
    for index in range(16):
        quarters = (
            whole(world, index).frames[0].reference.half_a.unfold(2, 32, 32).unfold(3, 32, 32)
        )
        ways.add(tuple(quarters.sum((0, 1, 4, 5)).flatten().argsort().tolist()))
    assert len(ways) >= 5  # of the eight that there are; fewer in one of 10,000 sets of 16


@pytest.mark.parametrize("index", range(3))
def test_one_exposure_holds_for_samples_and_references_of_all_frames(world, index):
    gains = []
    for frame, source in zip(whole(world, index), open_clip(world), strict=True):
        drawn = (frame.pool.radiance, frame.reference.half_a, frame.reference.half_b)
        stored = (source.pool.radiance, source.reference.half_a, source.reference.half_b)
        gains += [float(a.sum() / b.sum()) for a, b in zip(drawn, stored, strict=True)]
    assert gains == pytest.approx([gains[0]] * 6, rel=1e-4)  # sums in float32
    assert 2**-0.5 <= gains[0] <= 2**0.5


def test_exposures_differ_from_draw_to_draw(world):
    sums = {float(whole(world, index).frames[0].reference.half_a.sum()) for index in range(4)}
    assert len(sums) == 4


def test_the_same_samples_are_sold_in_another_order_in_each_draw(world):
    orders = []
    (source, _) = open_clip(world)
    stored = source.pool.radiance.sum((0, 2, 3, 4)).sort().values
    for index in range(4):
        frame = whole(world, index).frames[0]
        sums = frame.pool.radiance.sum((0, 2, 3, 4))
        torch.testing.assert_close(sums.sort().values / sums.sum(), stored / stored.sum())
        orders.append(tuple(sums.argsort().tolist()))
    assert len(set(orders)) == 4


def test_budgets_are_drawn_alike_by_number_and_all_of_them():
    drawn = [sample_budget((0.5, 1.0, 4.0), seed=2, draw=draw) for draw in range(60)]
    assert drawn == [sample_budget((0.5, 1.0, 4.0), seed=2, draw=draw) for draw in range(60)]
    assert min(drawn.count(spp) for spp in (0.5, 1.0, 4.0)) >= 10  # of 20, deviation 3.7


def test_what_is_read_ahead_is_what_is_drawn(world):
    batches = Batches([world], batch=2, crop=32, length=2, seed=1)
    with prefetch(batches) as draw:
        early = [draw(index) for index in (0, 1, 2, 7, 3)]  # in order, and not
    for index, clip in zip((0, 1, 2, 7, 3), early, strict=True):
        late = batches.sequence(index)
        torch.testing.assert_close(_tensors(clip), _tensors(late), rtol=0, atol=0)


def test_what_stops_the_reading_is_raised_when_it_is_asked_for(tmp_path):
    large, small = write_noise(tmp_path / "a", h=64, w=64), write_noise(tmp_path / "b", h=16, w=16)
    batches = Batches([large, small], batch=1, crop=32, length=2, seed=0)
    fine = [index for index in range(20) if _drawn(batches, index)]
    last = next(index for index in fine if index + 1 not in fine)
    with prefetch(batches) as draw:
        assert draw(last)  # while the next one fails
        with pytest.raises(BatchError, match="crops of 32 x 32 asked for, clip 'b'"):
            draw(last + 1)


def _drawn(batches: Batches, index: int) -> bool:
    try:
        return bool(batches.sequence(index))
    except BatchError:
        return False


def _tensors(clip: InMemoryClip) -> list[Tensor]:
    parts = [[f.pool.radiance, f.reference.half_a, *f.gbuffer.buffers.values()] for f in clip]
    return [tensor for part in parts for tensor in part]


def test_scene_and_budget_of_a_draw_are_drawn_apart(tmp_path):
    lengths, budgets = range(1, 5), (0.5, 1.0, 2.0, 4.0)
    folders = [write_noise(tmp_path / str(n), h=16, w=16, frames=n) for n in lengths]
    batches = Batches(folders, batch=1, crop=16, length=4, seed=0)
    pairs = {(len(batches.sequence(n).frames), sample_budget(budgets, 0, n)) for n in range(96)}
    assert len(pairs) == 16  # each is missed by 96 draws with probability 0.002
