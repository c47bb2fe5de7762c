"""Training batches: crops that stay in place, augmented alike over all frames; prefetching."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path

import pytest
import torch
from torch import Tensor

from rlbench.clips import decode_cache
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.clips.stored import open_clip
from rlbench.frames import Size
from rlbench.ops.reprojection import reproject
from rlbench.training.batches import (
    Augmentation,
    BatchError,
    Batches,
    ResidentClip,
    prefetch,
    sample_budget,
    sequence_budget,
)
from tests.conftest import write_noise
from tests.procedural_folder import write_world


@pytest.fixture
def world(tmp_path: Path) -> Path:
    return write_world(tmp_path / "world", seed=3, side=64, frames=2)


def uncropped(folder: Path, index: int) -> InMemoryClip:
    """A sequence of all pixels and frames of a clip of 64 x 64 pixels."""
    return Batches([folder], batch=1, crop=64, sequence_length=2, seed=0).sequence(index)


def error(previous: Tensor, current: Tensor, motion: Tensor) -> float:
    """Median difference of a frame and the reprojected last one, where that is valid."""
    reprojected, valid = reproject(previous, motion)
    return float((reprojected - current).abs()[valid.expand_as(current)].median())


@pytest.mark.parametrize("index", range(3))  # sequences, each transformed in its way
def test_a_crop_stays_in_place_and_moves_as_its_motion(world, index):
    previous, current = (
        Batches([world], batch=1, crop=40, sequence_length=2, seed=0).sequence(index).frames
    )
    albedos, motion = (previous.gbuffer.albedo, current.gbuffer.albedo), current.gbuffer.motion
    # blur of a texture, against its movement; twice the latter if motion is transformed wrongly
    assert error(*albedos, motion) < error(*albedos, 0 * motion) / 2


def test_sequences_are_transformed_in_many_ways(world):
    ways = set()
    for index in range(16):
        quarters = (
            uncropped(world, index).frames[0].reference.half_a.unfold(2, 32, 32).unfold(3, 32, 32)
        )
        ways.add(tuple(quarters.sum((0, 1, 4, 5)).flatten().argsort().tolist()))
    assert len(ways) >= 5  # of the eight that there are; fewer in one of 10,000 sets of 16


def test_all_frames_of_a_sequence_have_one_exposure_and_sequences_differ(world):
    exposures = set()
    for index in range(3):
        gains = []
        for frame, source in zip(uncropped(world, index), open_clip(world), strict=True):
            drawn = (frame.pool.radiance, frame.reference.half_a, frame.reference.half_b)
            stored = (source.pool.radiance, source.reference.half_a, source.reference.half_b)
            gains += [float(a.sum() / b.sum()) for a, b in zip(drawn, stored, strict=True)]
        assert gains == pytest.approx([gains[0]] * 6, rel=1e-4)  # sums in float32
        assert 2**-0.5 <= gains[0] <= 2**0.5
        exposures.add(gains[0])
    assert len(exposures) == 3


def test_each_sequence_has_the_same_samples_in_another_order(world):
    orders = []
    (source, _) = open_clip(world)
    stored = source.pool.radiance.sum((0, 2, 3, 4)).sort().values
    for index in range(4):
        frame = uncropped(world, index).frames[0]
        sums = frame.pool.radiance.sum((0, 2, 3, 4))
        torch.testing.assert_close(sums.sort().values / sums.sum(), stored / stored.sum())
        orders.append(tuple(sums.argsort().tolist()))
    assert len(set(orders)) == 4


def test_budgets_depend_on_the_index_only_and_all_are_drawn():
    drawn = [sample_budget((0.5, 1.0, 4.0), seed=2, index=index) for index in range(60)]
    assert drawn == [sample_budget((0.5, 1.0, 4.0), seed=2, index=index) for index in range(60)]
    assert min(drawn.count(spp) for spp in (0.5, 1.0, 4.0)) >= 10  # of 20, deviation 3.7


def test_prefetched_sequences_are_those_read_directly(world):
    batches = Batches([world], batch=2, crop=32, sequence_length=2, seed=1)
    with prefetch(batches) as sequence:
        prefetched = [sequence(index) for index in (0, 1, 2, 7, 3)]  # in order, and not
    for index, clip in zip((0, 1, 2, 7, 3), prefetched, strict=True):
        direct = batches.sequence(index)
        torch.testing.assert_close(_tensors(clip), _tensors(direct), rtol=0, atol=0)


def test_an_error_of_prefetching_is_raised_when_the_sequence_is_requested(tmp_path):
    large, small = write_noise(tmp_path / "a", h=64, w=64), write_noise(tmp_path / "b", h=16, w=16)
    batches = Batches([large, small], batch=1, crop=32, sequence_length=2, seed=0)
    readable = [index for index in range(20) if _is_readable(batches, index)]
    last = next(index for index in readable if index + 1 not in readable)
    with prefetch(batches) as sequence:
        assert sequence(last)  # while the next one fails
        with pytest.raises(BatchError, match="32 x 32 pixels were requested, but clip 'b'"):
            sequence(last + 1)


def _is_readable(batches: Batches, index: int) -> bool:
    try:
        return bool(batches.sequence(index))
    except BatchError:
        return False


def _tensors(clip: InMemoryClip) -> list[Tensor]:
    parts = [[f.pool.radiance, f.reference.half_a, *f.gbuffer.buffers.values()] for f in clip]
    return [tensor for part in parts for tensor in part]


def test_scene_and_budget_of_a_sequence_are_independent(tmp_path):
    lengths, budgets = range(1, 5), (0.5, 1.0, 2.0, 4.0)
    folders = [write_noise(tmp_path / str(n), h=16, w=16, frames=n) for n in lengths]
    batches = Batches(folders, batch=1, crop=16, sequence_length=4, seed=0)
    pairs = {(len(batches.sequence(n).frames), sample_budget(budgets, 0, n)) for n in range(96)}
    assert len(pairs) == 16  # each is missed by 96 sequences with probability 0.002


@pytest.mark.parametrize("batch", [1, 3])
def test_the_share_of_sequences_from_mixed_in_clips_is_the_one_requested(tmp_path, batch):
    """The first clip of each of 200 sequences; a share outside the bounds has a chance of 1e-4."""
    few = [write_noise(tmp_path / "two", h=16, w=16, frames=2, pool_spp=2)]
    many = [write_noise(tmp_path / str(n), h=16, w=16, frames=3, pool_spp=4) for n in range(4)]
    batches = Batches(many, batch, 16, 3, seed=0, mixed_in=few, mix=0.3)
    count = sum(len(batches.sequence(index)) == 2 for index in range(200))
    assert abs(count - 60) < 4 * (200 * 0.3 * 0.7) ** 0.5


def test_no_clip_is_in_two_sequences_in_a_row(tmp_path):
    folders = [write_noise(tmp_path / str(n), h=16, w=16, frames=n) for n in range(1, 6)]
    batches = Batches(folders, batch=1, crop=16, sequence_length=5, seed=0)
    drawn = [len(batches.sequence(index)) for index in range(200)]  # each clip has its own length
    assert all(one != other for one, other in itertools.pairwise(drawn))
    # 40 of each, within four standard deviations of independent draws
    assert all(abs(count - 40) < 4 * (200 * 0.2 * 0.8) ** 0.5 for count in Counter(drawn).values())


def test_clips_of_other_sizes_lengths_and_pools_make_batches(tmp_path):
    shapes = ((16, 24, 2, 2), (40, 20, 5, 2), (32, 32, 3, 8), (20, 20, 4, 8))
    folders = [
        write_noise(tmp_path / str(n), h=h, w=w, frames=frames, pool_spp=spp)
        for n, (h, w, frames, spp) in enumerate(shapes)
    ]
    batches = Batches(folders, batch=3, crop=16, sequence_length=3, seed=0)
    clips = [batches.sequence(index) for index in range(24)]
    assert {clip.size for clip in clips} == {Size(3, 16, 16)}
    assert {len(clip) for clip in clips} == {2, 3}
    assert {clip.frames[0].pool.radiance.shape[1] for clip in clips} == {2, 8}


def test_a_budget_is_limited_to_the_stored_samples(tmp_path):
    folder = write_noise(tmp_path / "few", h=16, w=16, pool_spp=2)
    clip = Batches([folder], batch=1, crop=16, sequence_length=2, seed=0).sequence(0)
    assert [sequence_budget(clip, (spp,), 0, 0) for spp in (0.5, 2.0, 4.0)] == [0.5, 2.0, 2.0]


@pytest.mark.parametrize(("clips", "mix"), [(1, 0.0), (1, 1.0), (0, 0.5)])
def test_a_share_without_clips_to_mix_and_clips_without_a_share_are_refused(tmp_path, clips, mix):
    folder = write_noise(tmp_path / "noise", h=16, w=16)
    with pytest.raises(BatchError, match=f"{clips} clips are mixed in at a share of {mix:g}"):
        Batches([folder], 1, 16, 2, seed=0, mixed_in=[folder] * clips, mix=mix)


def test_clips_outside_of_the_cache_are_decoded_once(tmp_path, monkeypatch):
    folder = write_noise(tmp_path / "mine" / "shot", h=16, w=16, frames=1)
    batches = Batches([folder], batch=2, crop=16, sequence_length=1, seed=0)
    list(batches.sequence(0))
    monkeypatch.setattr(decode_cache, "read_channels", None)  # would raise TypeError
    frame = batches.sequence(1).frames[0]
    assert frame.reference.mean.shape == (2, 3, 16, 16)


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("transpose", [False, True])
def test_an_augmented_clip_moves_as_its_augmented_motion(mirror, flip, transpose):
    """Reprojecting the augmented previous frame equals augmenting the reprojected one."""
    augmentation = Augmentation(mirror, flip, transpose, gain=1.5, channels=(2, 0, 1))
    clip = procedural_clip(seed=3, size=Size(1, 64, 80), frames=2)
    previous, current = list(clip)
    reprojected, valid = reproject(previous.gbuffer.albedo, current.gbuffer.motion)
    previous_crop, current_crop = augmentation.apply(previous), augmentation.apply(current)
    reprojected_crop, valid_crop = reproject(
        previous_crop.gbuffer.albedo, current_crop.gbuffer.motion
    )
    known = valid_crop & augmentation.transform(valid)
    assert known.float().mean() > 0.5
    difference = (reprojected_crop - augmentation.permute_channels(reprojected)).abs() * known
    assert difference.max() < 1e-4  # bilinear weights in float32


def test_crops_larger_than_a_clip_are_refused(tmp_path):
    clip = write_noise(tmp_path / "noise", h=32, w=40)
    with pytest.raises(
        BatchError, match="48 x 48 pixels were requested, but clip 'noise' has 32 x 40"
    ):
        Batches([clip], batch=1, crop=48, sequence_length=2, seed=0).sequence(0)


def test_batches_without_clips_are_refused():
    with pytest.raises(BatchError, match="render --preset train"):
        Batches([], batch=1, crop=48, sequence_length=2, seed=0)


@pytest.mark.parametrize("batch", [1, 3])
def test_crops_of_clips_in_memory_equal_those_of_files(tmp_path, batch):
    clips = [write_world(tmp_path / f"{seed}", seed=seed, side=64, frames=3) for seed in range(2)]
    stored, resident = (
        Batches(clips, batch=batch, crop=40, sequence_length=2, seed=0) for _ in range(2)
    )
    resident.__dict__["_sources"] = tuple(map(ResidentClip.load, resident.stored_clips))
    for index in range(4):
        for one, other in zip(stored.sequence(index), resident.sequence(index), strict=True):
            assert one.gbuffer.buffers.keys() == other.gbuffer.buffers.keys()
            for name, buffer in one.gbuffer.buffers.items():
                assert torch.equal(buffer, other.gbuffer.buffers[name])
            assert torch.equal(one.pool.radiance, other.pool.radiance)
            assert one.pool.rounding_seeds == other.pool.rounding_seeds
            assert torch.equal(one.reference.half_a, other.reference.half_a)
            assert torch.equal(one.reference.half_b, other.reference.half_b)
            assert (one.is_sanitized, other.is_sanitized) == (False, True)


def test_broken_values_of_clips_in_memory_are_repaired_once(tmp_path):
    clip = open_clip(write_world(tmp_path / "world", seed=3, side=64, frames=2))
    slots = [array for index in range(2) for array in clip.arrays.pool("path", index, range(8))]
    slots[3][:, 5, 7] = torch.inf  # a map of the file in memory; the file stays
    resident = ResidentClip.load(clip)
    assert resident.frame.pool.radiance.max() <= 65504
    assert len(resident) == 2
