"""Engines: the same outcomes here and on Ray, and what becomes of workers that die."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from functools import partial

import pytest

from rlbench.benchmark import results as table
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import RunSummary, measure
from rlbench.parallel import ray_executor, worker
from rlbench.parallel.executor import LOCAL, EngineError
from rlbench.parallel.ray_executor import RayExecutor, opened
from rlbench.registry.lookup import VARIABLE, use_plugin
from rlbench.render.jobs.job import Job
from rlbench.render.jobs.render_clips import render_missing
from tests.benchmark.test_runner import scores
from tests.conftest import write_noise, write_plugin
from tests.render.test_record import PLAN, contents
from tests.render.worlds import room

RETRIES = 1


@pytest.fixture(scope="module")
def workers():
    """A local Ray, for all tests of this file: starting one takes seconds."""
    pytest.importorskip("ray", reason='pip install "rlbench[ray]"')
    engine = RayExecutor(retries=RETRIES)
    yield engine
    engine.close()


def halved(job, tell):
    tell(1.0)
    return 1 / job


def fragile(folder, job, tell):
    """Dies the first times, as often as `job` says, then says how often it was begun."""
    begun = len(list(folder.glob(f"{job}-*"))) + 1
    (folder / f"{job}-{begun}").touch()
    if begun <= job:
        os.kill(os.getpid(), signal.SIGKILL)
    return begun


def test_a_job_that_raises_does_not_stop_the_others_here():
    outcomes = list(LOCAL.map(halved, [2, 0, 4]))
    assert [o.made for o in outcomes] == [(0.5,), (), (0.25,)]
    with pytest.raises(ZeroDivisionError):
        outcomes[1].result()


def test_a_clip_that_cannot_be_read_takes_no_other_with_it(tmp_path):
    """Though times are taken before cells are handed out, and both would have the same."""
    folders = [write_noise(tmp_path / name) for name in ("aaa", "bbb")]
    (folders[0] / "pool.path.0000.exr").write_bytes(b"no EXR")
    asked = RunPlan(("mean",), tuple(map(StoredSource, folders)), spp=(1.0,), repeats=2)
    done = measure(asked, tmp_path / "r", engine=replace(LOCAL, alone=False))
    assert done == RunSummary(measured=1, skipped=1)
    rows = table.read(tmp_path / "r")
    assert set(rows[rows["value"].isna() & (rows["metric"] == "psnr")]["clip"]) == {"aaa"}


@pytest.mark.slow
def test_a_job_that_raises_does_not_stop_the_others_on_ray(workers):
    outcomes = {o.job: o for o in workers.map(halved, [2, 0, 4])}
    assert {job: o.made for job, o in outcomes.items()} == {2: (0.5,), 0: (), 4: (0.25,)}


@pytest.mark.slow
def test_an_error_on_ray_is_the_jobs_own_and_says_where_it_was_raised(workers):
    (outcome,) = workers.map(halved, [0])
    with pytest.raises(ZeroDivisionError) as raised:
        outcome.result()
    assert "in halved" in raised.value.__notes__[0]


@pytest.mark.slow
def test_progress_on_ray_is_all_that_jobs_told(workers):
    told = []
    list(workers.map(halved, [1, 2, 3], tell=told.append))
    assert sum(told) == 3.0


@pytest.mark.slow
def test_a_job_whose_worker_was_killed_is_sent_again(workers, tmp_path):
    assert [o.made for o in workers.map(partial(fragile, tmp_path), [RETRIES])] == [(2,)]


@pytest.mark.slow
def test_a_job_that_kills_every_worker_ends_with_a_reason_and_the_others_go_on(workers, tmp_path):
    found = {o.job: o for o in workers.map(partial(fragile, tmp_path), [99, 0])}
    assert found[0].made == (1,)
    with pytest.raises(EngineError, match="worker died 2 times, the last time of WorkerCrashed"):
        found[99].result()


@pytest.mark.slow
def test_ray_reports_nothing_to_its_makers(workers):
    list(workers.map(halved, [1]))
    from ray._common.usage import usage_lib

    assert not usage_lib.usage_stats_enabled()


@pytest.mark.slow
def test_clips_rendered_on_ray_are_those_rendered_here_bit_for_bit(workers, tmp_path):
    folders = {}
    for name, engine in (("here", LOCAL), ("ray", workers)):
        jobs = [Job(each, room(), PLAN, tmp_path / name / each) for each in ("a", "b")]
        folders[name] = render_missing(jobs, engine=engine)
    for here, there in zip(folders["here"], folders["ray"], strict=True):
        assert contents(here) == contents(there)
        assert len(contents(there)) == 4 * PLAN.frames
        assert told(here) == told(there)


@pytest.mark.slow
def test_scores_from_ray_are_those_from_here_bit_for_bit(workers, tmp_path, monkeypatch):
    use_plugin(write_plugin(tmp_path / "loose.py", "loose", gain=0.9))
    package = tmp_path / "elsewhere"
    package.mkdir()
    write_plugin(package / "faraway.py", "far", body="raise RuntimeError('no luck')")
    monkeypatch.syspath_prepend(str(package))
    monkeypatch.setenv(VARIABLE, "far=faraway:FAMILY")
    clips = tuple(StoredSource(write_noise(tmp_path / "clips" / name)) for name in ("a", "bb"))
    asked = RunPlan(
        ("mean", "ours", "loose", "far"), clips, spp=(0.5, 2.0), repeats=2, cost="paper-2080ti"
    )
    here = measure(asked, tmp_path / "here")
    there = measure(asked, tmp_path / "there", engine=workers)
    assert here == there == RunSummary(measured=12, skipped=4)
    # as words, for no nan equals another
    assert repr(scores(tmp_path / "here")) == repr(scores(tmp_path / "there"))
    assert rows(tmp_path / "here") == rows(tmp_path / "there")
    assert table.cells(tmp_path / "here") == table.cells(tmp_path / "there")
    assert measure(asked, tmp_path / "there", engine=workers).cached == 12


@pytest.mark.slow
def test_a_method_that_kills_its_process_is_a_row_with_the_reason(workers, clip_folder, tmp_path):
    body = "import os; os.kill(os.getpid(), 9)"
    use_plugin(write_plugin(tmp_path / "deadly.py", "deadly", body=body))
    clips = (StoredSource(clip_folder),)
    asked = RunPlan(("deadly", "mean"), clips, spp=(1.0,), repeats=2, cost="paper-2080ti")
    done = measure(asked, tmp_path / "r", engine=workers)
    assert done == RunSummary(measured=1, skipped=1)
    found = table.read(tmp_path / "r")
    (why,) = found[found["method"] == "deadly"]["note"]
    assert why.startswith("EngineError: its worker died 2 times")


def test_a_worker_with_other_code_refuses_to_work():
    setting = replace(worker.setting(cpus=1), code="torch 1.0, code 0123")
    with pytest.raises(EngineError, match="install the same on both"):
        setting.apply()


def test_without_ray_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(ray_executor.sys.modules, "ray", None)  # as import finds a missing package
    with pytest.raises(EngineError, match=r'pip install "rlbench\[ray\]"'), opened("ray"):
        pass


@pytest.mark.parametrize(
    ("name", "address", "told"),
    [
        ("dask", None, "one of: local, ray"),
        ("local", "auto", "belongs to --engine ray"),
    ],
)
def test_an_engine_that_is_not_there_is_told(name, address, told):
    with pytest.raises(EngineError, match=told), opened(name, address):
        pass


def test_ray_client_is_refused():
    pytest.importorskip("ray")
    with (
        pytest.raises(EngineError, match="on a machine of the cluster"),
        opened("ray", "ray://a:1"),
    ):
        pass


def told(folder):
    """What a clip says of itself, without how long a sample took."""
    text = (folder / "clip.toml").read_text()
    return [line for line in text.splitlines() if not line.startswith("sample_ms")]


def rows(results):
    """All rows without their values: those of times are other ones every time."""
    found = table.read(results).drop(columns=["value"])
    return sorted(map(repr, found.itertuples(index=False, name=None)))
