"""Executors give the same results in this process and on Ray, also when workers die."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
from dataclasses import replace
from functools import partial

import pytest
import torch

from rlbench.apps.cluster.ray_executor import RayExecutor, WorkerEnvironment, code_version
from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.jobs.render_clips import render_missing
from rlbench.benchmark import results
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import RunSummary, measure
from rlbench.parallel.engines import open_executor
from rlbench.parallel.executor import LOCAL, ExecutorError, Resources
from rlbench.registry import list_plugins, use_plugin
from tests.apps.render.jobs.test_render_clips import PRESET, contents
from tests.apps.render.small_scenes import room
from tests.benchmark.test_runner import scores
from tests.conftest import install_plugin, write_noise, write_plugin

MAX_RETRIES = 1
NEEDS_RAY = pytest.mark.skipif(
    not importlib.util.find_spec("ray"), reason='pip install "rlbench[ray]"'
)


@pytest.fixture(scope="module")
def shared_cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def _shared_cache(_own_cache, shared_cache, monkeypatch):
    """One cache for all tests of this file: Ray starts new workers for other variables."""
    monkeypatch.setenv("RLBENCH_CACHE", str(shared_cache))


@pytest.fixture(autouse=True)
def _installed_plugins():
    """Each process reads once what is installed, and some tests install more."""
    code_version.cache_clear()


@pytest.fixture(scope="module")
def workers():
    """A local Ray for all tests of this file, since starting one takes seconds."""
    pytest.importorskip("ray", reason='pip install "rlbench[ray]"')
    executor = RayExecutor(max_retries=MAX_RETRIES)
    yield executor
    executor.close()


def reciprocal(job, on_progress):
    on_progress(1.0)
    return 1 / job


def crash(folder, job, on_progress):
    """Kill the worker the first `job` times, then return the number of attempts."""
    attempt = len(list(folder.glob(f"{job}-*"))) + 1
    (folder / f"{job}-{attempt}").touch()
    if attempt <= job:
        os.kill(os.getpid(), signal.SIGKILL)
    return attempt


def describe_worker(job, on_progress):
    """The settings of the worker that runs the job."""
    variables = {name: value for name, value in os.environ.items() if name.startswith("RLBENCH_")}
    importable = importlib.util.find_spec(job) is not None
    return variables, os.getcwd(), torch.get_num_threads(), importable


def test_a_job_that_raises_does_not_stop_the_others_in_this_process():
    first, failed, last = LOCAL.map(reciprocal, [2, 0, 4])
    assert (first.result(), last.result()) == (0.5, 0.25)
    assert (first.error, failed.value, last.error) == (None, None, None)
    with pytest.raises(ZeroDivisionError):
        failed.result()


def test_a_clip_that_cannot_be_read_does_not_stop_the_others(tmp_path):
    """Times are measured before cells are distributed, and both clips would share one."""
    folders = [write_noise(tmp_path / name) for name in ("aaa", "bbb")]
    (folders[0] / "pool.path.0000.exr").write_bytes(b"no EXR")
    plan = RunPlan(("mean",), tuple(map(StoredSource, folders)), spp=(1.0,), repeats=2)
    summary = measure(plan, tmp_path / "r", executor=replace(LOCAL, exclusive=False))
    assert summary == RunSummary(measured=1, failed=1)
    rows = results.read(tmp_path / "r")
    assert set(rows[rows["value"].isna() & (rows["metric"] == "psnr")]["clip"]) == {"aaa"}


@pytest.mark.slow
def test_a_job_that_raises_on_ray_has_its_own_error_and_the_others_finish(workers):
    progress = []
    jobs = workers.map(reciprocal, [2, 0, 4], on_progress=progress.append)
    replies = {reply.job: reply for reply in jobs}
    assert {job: reply.value for job, reply in replies.items()} == {2: 0.5, 0: None, 4: 0.25}
    assert sum(progress) == 2.0  # of the jobs with a value
    with pytest.raises(ZeroDivisionError) as raised:
        replies[0].result()
    assert "in reciprocal" in raised.value.__notes__[0]  # of the worker


@pytest.mark.slow
def test_a_job_whose_worker_was_killed_is_run_again_until_it_is_an_error(workers, tmp_path):
    jobs = workers.map(partial(crash, tmp_path), [99, MAX_RETRIES, 0])
    replies = {reply.job: reply for reply in jobs}
    assert (replies[0].result(), replies[MAX_RETRIES].result()) == (1, 2)
    with pytest.raises(ExecutorError, match="worker died 2 times, the last time of WorkerCrashed"):
        replies[99].result()
    assert len(list(tmp_path.glob("99-*"))) == MAX_RETRIES + 1


@pytest.mark.slow
def test_a_worker_has_the_settings_of_the_submitter(workers, tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("RLBENCH_VARIANT", "scalar_rgb")
    (reply,) = workers.map(describe_worker, ["only_here"])
    variables, folder, threads, importable = reply.result()
    assert variables["RLBENCH_VARIANT"] == "scalar_rgb"
    assert variables["RLBENCH_CACHE"] == os.environ["RLBENCH_CACHE"]
    assert variables["RLBENCH_THREADS"] == "1"
    assert (folder, threads, importable) == (str(tmp_path), torch.get_num_threads(), True)


def test_a_worker_drops_variables_and_plugins_that_the_submitter_does_not_have(
    tmp_path, monkeypatch
):
    own = WorkerEnvironment.of_this_process(cpus=1)
    monkeypatch.setenv("RLBENCH_VARIANT", "of the machine")
    use_plugin(write_plugin(tmp_path / "loose.py", "loose"))
    monkeypatch.chdir(tmp_path)
    own.apply()
    assert "RLBENCH_VARIANT" not in os.environ
    assert "loose" not in list_plugins("methods")
    assert os.getcwd() == own.folder


@pytest.mark.slow
def test_a_job_that_no_machine_can_run_is_an_error(workers):
    with pytest.raises(ExecutorError, match="a job takes 99 GPU, and no machine"):
        list(workers.map(reciprocal, [1], Resources(gpus=99)))


@pytest.mark.slow
def test_ray_sends_no_usage_statistics(workers):
    list(workers.map(reciprocal, [1]))
    from ray._common.usage import usage_lib

    assert not usage_lib.usage_stats_enabled()


@pytest.mark.slow
def test_clips_rendered_on_ray_and_in_this_process_are_bit_identical(workers, tmp_path):
    folders = {}
    for name, executor in (("local", LOCAL), ("ray", workers)):
        jobs = [Job(clip, room(), PRESET, tmp_path / name / clip) for clip in ("a", "b")]
        folders[name] = render_missing(jobs, executor=executor)
    for local, remote in zip(folders["local"], folders["ray"], strict=True):
        assert contents(local) == contents(remote)
        assert len(contents(remote)) == 4 * PRESET.frames
        assert header_without_time(local) == header_without_time(remote)


@pytest.mark.slow
def test_scores_from_ray_and_from_this_process_are_bit_identical(workers, tmp_path, monkeypatch):
    use_plugin(write_plugin(tmp_path / "loose.py", "loose", gain=0.9))
    package = tmp_path / "elsewhere"
    package.mkdir()
    write_plugin(package / "faraway.py", "far", body="raise RuntimeError('no luck')")
    install_plugin(package, monkeypatch, "methods", "far = faraway:FAMILY")
    clips = tuple(StoredSource(write_noise(tmp_path / "clips" / name)) for name in ("a", "bb"))
    methods = ("mean", "ours", "loose", "far")
    plan = RunPlan(methods, clips, spp=(0.5, 2.0), repeats=2, cost="paper-2080ti")
    local, remote = tmp_path / "local", tmp_path / "ray"
    summaries = measure(plan, local), measure(plan, remote, executor=workers)
    assert summaries == (RunSummary(measured=12, failed=4),) * 2
    assert repr(scores(local)) == repr(scores(remote))  # as text, since nan differs from nan
    assert rows_without_values(local) == rows_without_values(remote)
    assert results.cells(local) == results.cells(remote)
    assert measure(plan, remote, executor=workers).cached == 12


@pytest.mark.slow
def test_a_method_that_kills_its_worker_is_a_row_with_the_reason(workers, clip_folder, tmp_path):
    body = "import os; os.kill(os.getpid(), 9)"
    use_plugin(write_plugin(tmp_path / "deadly.py", "deadly", body=body))
    clips = (StoredSource(clip_folder),)
    plan = RunPlan(("deadly", "mean"), clips, spp=(1.0,), repeats=2, cost="paper-2080ti")
    summary = measure(plan, tmp_path / "r", executor=workers)
    assert summary == RunSummary(measured=1, failed=1)
    rows = results.read(tmp_path / "r")
    (reason,) = rows[rows["method"] == "deadly"]["note"]
    assert reason.startswith("ExecutorError: its worker died 2 times")


def test_a_worker_with_another_code_version_refuses_to_work():
    own = WorkerEnvironment.of_this_process(cpus=1)
    other = replace(own, code_version="torch 1.0, code 0123")
    with pytest.raises(ExecutorError, match="Install the same version on both"):
        other.apply()


def test_the_error_without_ray_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)  # as import finds a missing package
    with pytest.raises(ExecutorError, match=r'pip install "rlbench\[ray\]"'), open_executor("ray"):
        pass


@pytest.mark.parametrize(
    ("engine", "message"),
    [
        ("dask", "--engine dask: no such engine; available: local, ray"),
        ("local=auto", "--engine local=auto: local has no address"),
        pytest.param("ray=ray://a:1", "on a machine of the cluster", marks=NEEDS_RAY),
    ],
)
def test_an_engine_that_does_not_exist_is_an_error(engine, message):
    with pytest.raises(ExecutorError, match=message), open_executor(engine):
        pass


def header_without_time(folder):
    """The lines of a clip's header, without the times of its tracer."""
    times = ("sample_ms", "sample_p5_ms", "sample_p95_ms", "gbuffer_ms")
    text = (folder / "clip.toml").read_text()
    return [line for line in text.splitlines() if not line.startswith(times)]


def rows_without_values(folder):
    """All rows without their values, and times without what differs in every run."""
    rows = results.read(folder).drop(columns=["value"])
    is_time = rows["metric"].str.endswith("_ms") | rows["metric"].str.startswith("clock_")
    rows.loc[is_time, ["convention", "note"]] = ""
    return sorted(map(repr, rows.itertuples(index=False, name=None)))
