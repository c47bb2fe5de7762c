"""Sample pools of plugins, and the scene as they see it."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from baselines.restir.chains import BIASED, PLAIN, UNBIASED, Restir
from rlbench.apps.render.jobs import extra_pools
from rlbench.apps.render.jobs.extra_pools import PoolStage
from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.jobs.render_clips import render_clip, render_missing
from rlbench.apps.render.mitsuba.open_tracer import WavefrontTracer
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import Camera, Scene
from rlbench.clips.compatibility import incompatibility
from rlbench.clips.header import read_header
from rlbench.clips.presets import Preset
from rlbench.clips.stored import open_clip, verify
from rlbench.family import Traits
from tests.apps.render.conftest import check_no_kernel_is_compiled, own_cache
from tests.apps.render.jobs.test_render_clips import Killed, contents, killer
from tests.apps.render.small_scenes import diffuse, grey, room, square

PRESET = Preset("test", "tests", (16, 24), frames=4, reference_spp=2, pool_spp=2)
BOTH = replace(PRESET, pools=("path", "restir"))
H, W = 16, 24
SIGMAS = 4.0  # standard errors that a mean may deviate


def job(folder, preset=BOTH, scene=None):
    return Job("room", scene or room(), preset, folder)


@pytest.fixture(scope="module")
def rendered(usable_llvm, tmp_path_factory):
    """A clip with the path tracer's pool alone, and the same with the ReSTIR pool, added later."""
    folder = tmp_path_factory.mktemp("pools")
    with own_cache(tmp_path_factory):
        render_clip(job(folder / "plain", PRESET))
        shutil.copytree(folder / "plain", folder / "clip")
        render_missing([job(folder / "clip")])
    return folder


@pytest.fixture
def plain(llvm, rendered, tmp_path):
    return shutil.copytree(rendered / "plain", tmp_path / "plain")


@pytest.fixture
def clip(llvm, rendered, tmp_path):
    return shutil.copytree(rendered / "clip", tmp_path / "clip")


def test_a_pool_is_added_to_a_clip_and_nothing_else_is_touched(plain):
    before = {file: file.stat().st_mtime_ns for file in plain.glob("*.exr")}
    digest = open_clip(plain).digest
    render_missing([job(plain)])
    assert before == {file: file.stat().st_mtime_ns for file in before}
    assert open_clip(plain).digest == digest
    assert verify(plain) == []
    header = read_header(plain)
    assert header.pools == ("path", "restir")
    assert header.sample_ms_of("path") == header.sample_ms
    assert header.sample_ms_of("restir") > 0


def test_a_clip_rendered_with_both_pools_equals_one_to_which_a_pool_was_added(clip, tmp_path):
    render_clip(job(tmp_path / "both"))
    assert contents(tmp_path / "both") == contents(clip)


def test_each_pool_has_a_digest_of_its_own_and_a_finished_one_is_not_traced_again(clip):
    assert open_clip(clip, pool="restir").digest != open_clip(clip).digest
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
    kind = extra_pools.registry.load_plugin("pools", "restir")
    missing = extra_pools.MissingPool(job(clip), replace(kind, version=kind.version + 1))
    assert missing.missing_frames == [0, 1, 2, 3]
    missing.claim_files()
    assert read_header(clip).pools == ("path",)
    assert contents(clip, "pool.restir.*.exr") == {}


def test_the_scalar_variant_adds_no_pool_and_the_incompatibility_names_it(plain):
    select_variant("scalar_rgb")
    render_missing([job(plain)])
    header = read_header(plain)
    assert header.pools == ("path",)
    reason = incompatibility(header, Traits(pool="restir"), 1.0)
    assert "'restir' pool, the clip has: path" in reason


def open_scene(scene, time=0.0):
    tracer = WavefrontTracer(scene, H, W)
    tracer.set_time(time)
    return tracer


def chains(tracer, count, config=BIASED, indirect=True):
    return Restir(PoolStage(tracer, "restir"), range(count), config, indirect)


def camera_alone(depth):
    """The room in which only the camera moves: there the unbiased form is exact."""
    return replace(room(), vertex_animation=lambda time: {}, max_depth=depth)


def many_lamps():
    """A floor of 40 x 40 m under 400 lamps of 10 x 10 cm, half a metre above it."""
    x, y = np.meshgrid(np.arange(20.0) * 2 - 19, np.arange(20.0) * 2 - 19)
    lamp = {"type": "area", "radiance": grey(5.0)}
    each = square("lamps", 0.05, 0.5, diffuse(0, 0, 0), up=-1, emission=lamp)
    middle = np.stack([x.ravel(), y.ravel(), np.zeros(400)], 1)[:, None]
    vertices = (middle + each.vertices).reshape(-1, 3).astype(np.float32)
    faces = (np.arange(400)[:, None, None] * 4 + each.faces).reshape(-1, 3).astype(np.uint32)
    return Scene(
        name="lamps",
        title="Many lamps for tests",
        meshes=(
            square("floor", 20.0, 0.0, diffuse(0.5, 0.5, 0.5)),
            replace(each, vertices=vertices, faces=faces),
        ),
        camera=lambda time: Camera((0.02 * time, -6.0, 3.0), (0, 0, 0), fov=50.0),
        max_depth=2,
    )


def standard_errors(samples, reference, variance, spp):
    """Deviation of the means of 2 x 3 areas from those of a reference, in standard errors.

    `samples` [s h w 3] are independent; so are those of the reference, of this variance.
    """

    def areas(image):
        return image.reshape(*image.shape[:-3], 2, H // 2, 3, W // 3, 3).mean((-4, -2))

    means = areas(samples.astype(np.float64))
    scatter = means.var(0, ddof=1) / len(means) + areas(variance) / spp / (H * W / 6)
    return np.abs(means.mean(0) - areas(reference)) / np.sqrt(scatter)


def test_one_candidate_without_reuse_is_next_event_estimation(llvm):
    import mitsuba as mi

    tracer = open_scene(room(), 1.0)
    (samples,) = chains(tracer, 1, PLAIN, indirect=False)()

    pixels = mi.UInt32(np.arange(H * W))
    numbers = PoolStage(tracer, "restir").sampler(pixels, mi.UInt32(np.zeros(H * W)))
    jitter, place = numbers.next_2d(), numbers.next_2d()
    rows, columns = np.indices((H, W)).reshape(2, -1)
    ray = tracer.rays(mi.Float(columns) + jitter.x, mi.Float(rows) + jitter.y)
    hit = tracer.mi_scene.ray_intersect(ray)
    light, weight = tracer.mi_scene.sample_emitter_direction(hit, place, True, hit.is_valid())
    value = hit.bsdf(ray).eval(mi.BSDFContext(), hit, hit.to_local(light.d), hit.is_valid())
    expected = np.stack([(value * weight)[c].numpy() for c in range(3)], -1).reshape(H, W, 3)
    assert expected.max() > 0.1
    np.testing.assert_allclose(samples, expected, rtol=1e-4, atol=1e-6)  # W is 1, but for rounding


@pytest.mark.slow
@pytest.mark.parametrize("config", [PLAIN, UNBIASED], ids=["plain", "unbiased"])
@pytest.mark.parametrize("depth", [2, 6], ids=["direct", "direct and indirect"])
def test_means_are_those_of_the_path_tracer(llvm, config, depth):
    tracer = open_scene(camera_alone(depth))
    pool = chains(tracer, 256, config)
    for time in range(4):  # with a history of three frames
        tracer.set_time(float(time))
        samples = pool()
    paths = tracer.trace_images(4096, "referenceA").astype(np.float64)
    moments = paths.mean(0), paths.var(0, ddof=1)
    assert standard_errors(samples, *moments, len(paths)).max() < SIGMAS


@pytest.mark.slow
def test_the_biased_form_loses_little_light_and_gains_none(llvm):
    tracer = open_scene(camera_alone(2))
    pool = chains(tracer, 128)
    for time in range(6):
        tracer.set_time(float(time))
        samples = pool()
    ratio = samples.mean() / tracer.trace_mean(1024, "referenceA").mean()
    assert 0.85 < ratio < 1.02  # shadows darken where neighbours do not see the lamp: 0.92 here


@pytest.mark.slow
def test_under_many_lamps_its_variance_is_a_small_part_of_next_event_estimations(llvm):
    tracer = open_scene(many_lamps())
    plain, reused = chains(tracer, 32, PLAIN), chains(tracer, 32)
    for time in range(4):
        tracer.set_time(float(time))
        first, second = plain(), reused()
    assert second.var(0).mean() < first.var(0).mean() / 5
    truth = tracer.trace_mean(4096, "referenceA").mean()
    assert 0.7 < second.mean() / truth < 1.05


def test_no_history_survives_a_cut(llvm):
    tracer = open_scene(replace(room(), cuts=(2,)))
    pool = chains(tracer, 2)
    for time in (0.0, 1.0, 2.0):
        tracer.set_time(time)
        samples = pool()
    np.testing.assert_array_equal(samples, chains(tracer, 2)())


def test_disoccluded_pixels_have_no_history(llvm):
    def to_the_right(time):
        return Camera((0.5 * time, -6.0, 2.5), (0.5 * time, 0, 0.5), fov=50.0)

    tracer = open_scene(replace(room(), vertex_animation=lambda time: {}, camera=to_the_right))
    pool = chains(tracer, 1, replace(BIASED, passes=0))
    for time in (0.0, 1.0):
        tracer.set_time(time)
        pool()
    count = pool.history.reservoir.M.numpy().reshape(H, W)
    columns = np.arange(W) + 0.5 + pool.context.motion()[0].numpy().reshape(H, W)
    new = columns >= W
    assert new.any()
    assert set(np.unique(count[new])) <= {0, BIASED.candidates}
    assert (count[~new] == 2 * BIASED.candidates).mean() > 0.2  # the ground lies at a steep angle


def test_the_history_counts_at_most_twenty_times_the_current_frame(llvm):
    tracer = open_scene(room(static=True))
    pool = chains(tracer, 1, replace(BIASED, candidates=2, passes=0))
    for _ in range(25):
        pool()
    assert pool.history.reservoir.M.numpy().max() == 2 * (20 + 1)


def test_a_stream_does_not_depend_on_the_other_streams(llvm):
    tracer = open_scene(room())
    stage = PoolStage(tracer, "restir")
    pools = [Restir(stage, numbers) for numbers in (range(4), range(2), range(2, 4))]
    for time in (0.0, 1.0):
        tracer.set_time(time)
        all_streams, first, second = (pool() for pool in pools)
    same = (all_streams == np.concatenate([first, second])).all(-1)
    assert same.mean() > 0.99  # rays that meet two triangles at once, see WavefrontTracer


def test_no_kernel_is_compiled_after_the_second_frame(llvm):
    tracer = open_scene(room())
    pool = chains(tracer, 2)

    def trace(*times):
        for time in times:
            tracer.set_time(time)
            pool()

    trace(0.0, 1.0)
    check_no_kernel_is_compiled(lambda: trace(2.0, 3.0, 4.5))
