"""Pools with temporal reuse, added to finished clips."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.clips.compatibility import incompatibility
from rlbench.clips.stored import open_clip, read_header, verify
from rlbench.family import Traits
from rlbench.render.jobs import extra_pools
from rlbench.render.jobs.job import Job
from rlbench.render.jobs.render_clips import render_clip, render_missing
from rlbench.render.mitsuba.variant import select_variant
from rlbench.render.presets import Preset
from tests.render.small_scenes import room

PRESET = Preset("test", "tests", (16, 24), frames=4, reference_spp=2, pool_spp=2)
BOTH = replace(PRESET, pools=("path", "restir"))


def job(folder, preset=BOTH, scene=None):
    return Job("room", scene or room(), preset, folder)


def contents(folder, pattern="*.exr"):
    return {file.name: file.read_bytes() for file in sorted(folder.glob(pattern))}


@pytest.fixture
def plain(llvm, tmp_path):
    """A clip with the path tracer's pool alone."""
    render_clip(job(tmp_path / "plain", PRESET))
    return tmp_path / "plain"


@pytest.fixture
def clip(plain):
    """The same with the ReSTIR pool, added later."""
    render_missing([job(plain)])
    return plain


class Killed(BaseException):
    """Interrupts a rendering."""


def killer(after):
    calls = iter(range(after))

    def traced():
        if next(calls, None) is None:
            raise Killed

    return traced


def test_a_pool_is_added_to_a_clip_and_nothing_else_is_touched(plain):
    before = {file: file.stat().st_mtime_ns for file in plain.glob("*.exr")}
    digest = open_clip(plain).digest
    render_missing([job(plain)])
    assert before == {file: file.stat().st_mtime_ns for file in before}
    assert open_clip(plain).digest == digest
    assert read_header(plain).pools == ("path", "restir")
    assert verify(plain) == []


def test_a_clip_rendered_with_both_pools_equals_one_to_which_a_pool_was_added(clip, tmp_path):
    render_clip(job(tmp_path / "both"))
    assert contents(tmp_path / "both") == contents(clip)


def test_samples_of_each_pool_have_a_digest_of_their_own(clip):
    assert open_clip(clip, pool="restir").digest != open_clip(clip).digest


def test_a_finished_pool_is_not_traced_again(clip):
    assert extra_pools.find_missing_pools([job(clip)]) == []


@pytest.mark.parametrize(("bought", "traced"), [({"path"}, []), ({"restir"}, ["restir"])])
def test_a_pool_that_nobody_buys_from_is_not_traced(plain, monkeypatch, bought, traced):
    """`rlbench run` renders a preset with the pools of its methods."""
    names, add = [], extra_pools.add_pool
    monkeypatch.setattr(
        extra_pools,
        "add_pool",
        lambda pool, *rest: names.append(pool.kind.name) or add(pool, *rest),
    )
    render_missing([job(plain, BOTH.with_pools(bought))])
    assert names == traced


@pytest.mark.slow
@pytest.mark.parametrize("cuts", [(), (2,)], ids=["one shot", "a cut"])
@pytest.mark.parametrize("after", [1, 3])
def test_a_pool_that_was_interrupted_resumes_to_the_same_files(llvm, tmp_path, cuts, after):
    scene = replace(room(), cuts=cuts)
    complete, resumed = (job(tmp_path / name, scene=scene) for name in ("whole", "again"))
    render_missing([complete])
    render_missing([replace(resumed, preset=PRESET)])
    (missing,) = extra_pools.find_missing_pools([resumed])
    with pytest.raises(Killed):
        extra_pools.add_pool(missing, killer(after))
    assert read_header(resumed.folder).pools == ("path",)
    assert len(contents(resumed.folder, "pool.restir.*.exr")) == after + 1
    render_missing([resumed])
    assert contents(resumed.folder) == contents(complete.folder)


def test_a_lost_file_is_traced_again_and_the_others_are_left_alone(clip):
    before = contents(clip)
    written_ns = (clip / "pool.restir.0000.exr").stat().st_mtime_ns
    (clip / "pool.restir.0002.exr").unlink()
    render_missing([job(clip)])
    assert contents(clip) == before
    assert (clip / "pool.restir.0000.exr").stat().st_mtime_ns == written_ns


def test_a_pool_of_another_recipe_is_replaced(clip):
    (missing,) = [
        extra_pools.MissingPool(job(clip), replace(kind, version=kind.version + 1))
        for kind in [extra_pools.registry.load_plugin("pools", "restir")]
    ]
    assert missing.missing_frames == [0, 1, 2, 3]
    missing.claim_files()
    assert read_header(clip).pools == ("path",)
    assert contents(clip, "pool.restir.*.exr") == {}


def test_the_header_records_the_time_per_sample_of_each_pool(clip):
    header = read_header(clip)
    assert header.sample_ms_of("path") == header.sample_ms
    assert header.sample_ms_of("restir") > 0
    assert np.isnan(header.sample_ms_of("unheard"))


def test_the_scalar_variant_adds_no_pool_and_the_incompatibility_names_it(plain):
    select_variant("scalar_rgb")
    render_missing([job(plain)])
    header = read_header(plain)
    assert header.pools == ("path",)
    assert "'restir' pool, the clip has: path" in incompatibility(
        header, Traits(pool="restir"), 1.0
    )
