"""A stress run: every job has results, whatever a method does, and finished jobs are reused."""

from __future__ import annotations

import json

import pytest
import torch

from rlbench import registry
from rlbench.checks.result import Verdict
from rlbench.checks.stress import section
from rlbench.checks.stress.jobs import (
    StressJob,
    content_hash,
    default_executor,
    plan_jobs,
    run_jobs,
    write_results,
)
from rlbench.parallel.executor import LOCAL
from rlbench.parallel.process_executor import ProcessExecutor
from tests.conftest import write_plugin

CPU = torch.device("cpu")


def jobs_of(*methods, only=("budgets",)):
    return plan_jobs(methods, only, True, CPU)


def run(jobs, folder, **options):
    return {finished.job.title: finished for finished in run_jobs(jobs, folder, **options)}


def use_toy(folder, name="toy", **options):
    registry.use_plugin(write_plugin(folder / f"{name}.py", name, **options))


def test_jobs_of_the_suite_come_once_and_first():
    jobs = plan_jobs(["mean", "svgf"], ["budgets", "metrics"], False, CPU)
    assert [job.title for job in jobs] == ["metrics", "mean: budgets", "svgf: budgets"]


def test_a_finished_job_is_not_run_again(tmp_path):
    jobs = jobs_of("mean")
    first, second = run(jobs, tmp_path), run(jobs, tmp_path)
    assert not first["mean: budgets"].is_stored
    assert second["mean: budgets"].is_stored
    assert repr(second["mean: budgets"].results) == repr(first["mean: budgets"].results)  # with nan


def test_a_restart_runs_all_jobs_again(tmp_path):
    jobs = jobs_of("mean")
    run(jobs, tmp_path)
    assert not run(jobs, tmp_path, is_restart=True)["mean: budgets"].is_stored


def test_the_quick_and_the_full_form_are_stored_apart(tmp_path):
    run(jobs_of("mean"), tmp_path)
    (full,) = plan_jobs(["mean"], ["budgets"], False, CPU)
    (quick,) = jobs_of("mean")
    assert content_hash(full) != content_hash(quick)
    assert len(list((tmp_path / "jobs").iterdir())) == 1


def test_a_changed_method_is_run_again(tmp_path):
    use_toy(tmp_path)
    jobs = jobs_of("toy")
    run(jobs, tmp_path)
    file = tmp_path / "toy.py"
    file.write_text(f"{file.read_text()}\n# changed\n")
    assert not run(jobs, tmp_path)["toy: budgets"].is_stored


@pytest.mark.parametrize("damage", [b"", b"{", b"\xff\xfe", b'{"schema": 2}'])
def test_a_damaged_result_is_measured_again(tmp_path, damage):
    jobs = jobs_of("mean")
    run(jobs, tmp_path)
    (file,) = (tmp_path / "jobs").iterdir()
    file.write_bytes(damage)
    assert not run(jobs, tmp_path)["mean: budgets"].is_stored
    assert json.loads(file.read_text())["results"]


def test_jobs_with_similar_names_have_their_own_files(tmp_path):
    results = {}
    for name in ("a/b", "a-b"):
        write_results(tmp_path, StressJob("budgets", name, True, "cpu"), "hash", ())
        results[name] = len(list((tmp_path / "jobs").iterdir()))
    assert results == {"a/b": 1, "a-b": 2}


FAULTS = {  # body of the build function: what is found
    "raise OSError('no licence')": "raised OSError: no licence",
    "raise SystemExit('bye')": "raised PluginExitError: plugin code called sys.exit('bye')",
}


@pytest.mark.parametrize("build", FAULTS)
def test_a_method_that_cannot_be_built_fails_and_the_others_run(tmp_path, build):
    use_toy(tmp_path, build=build)
    finished = run(jobs_of("toy", "mean"), tmp_path)
    (result,) = finished["toy: budgets"].results
    assert result.verdict is Verdict.FAILED
    assert FAULTS[build] in result.found
    assert "(toy.py:" in result.found
    assert len(finished["mean: budgets"].results) > 5


def test_a_failed_job_runs_again_next_time(tmp_path):
    use_toy(tmp_path, build="raise OSError('no licence')")
    run(jobs_of("toy"), tmp_path)
    assert not run(jobs_of("toy"), tmp_path)["toy: budgets"].is_stored


def test_a_row_without_shipped_weights_is_skipped(tmp_path):
    (result,) = run(jobs_of("nppd/large"), tmp_path)["nppd/large: budgets"].results
    assert result.verdict is Verdict.SKIPPED
    assert result.found.startswith("has no shipped weights")


def test_a_method_whose_package_is_missing_is_skipped(tmp_path):
    plugin = write_plugin(tmp_path / "toy.py", "toy")
    plugin.write_text(
        plugin.read_text().replace("learned=False", "learned=False, requires=('no-such-package',)")
    )
    registry.use_plugin(plugin)
    (result,) = run(jobs_of("toy"), tmp_path)["toy: budgets"].results
    assert result.verdict is Verdict.SKIPPED
    assert "pip install no-such-package" in result.found


def test_a_section_that_cannot_be_imported_fails_once(tmp_path, monkeypatch):
    (tmp_path / "torn_section.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(section.CORE_SECTIONS, "torn", "torn_section:SECTION")
    finished = run(jobs_of("mean", "svgf", only=("torn",)), tmp_path)
    (result,) = finished["torn"].results
    assert result.verdict is Verdict.FAILED
    assert "ZeroDivisionError" in result.found


def test_results_before_an_exception_of_a_section_are_kept(tmp_path, monkeypatch):
    (tmp_path / "half_section.py").write_text(
        "from rlbench.checks.result import not_applicable\n"
        "from rlbench.checks.stress.section import MethodSection\n"
        "def run(stressed, is_quick):\n"
        "    yield not_applicable('first', 'no reason')\n"
        "    raise KeyError('second')\n"
        "SECTION = MethodSection(run)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(section.CORE_SECTIONS, "half", "half_section:SECTION")
    results = run(jobs_of("mean", only=("half",)), tmp_path)["mean: half"].results
    assert [(r.check, r.verdict) for r in results] == [
        ("first", Verdict.SKIPPED),
        ("run", Verdict.FAILED),
    ]


@pytest.mark.slow
def test_two_processes_give_the_results_of_one_and_survive_a_crash(tmp_path):
    use_toy(tmp_path, body="import os; os.kill(os.getpid(), 9)")
    jobs = jobs_of("toy", "mean", "eaw")
    parallel = run(jobs, tmp_path / "two", executor=ProcessExecutor(2))
    (result,) = parallel["toy: budgets"].results
    assert result.verdict is Verdict.FAILED
    assert "its process ended" in result.found
    alone = run(jobs[1:], tmp_path / "one")
    for title, finished in alone.items():
        assert repr(parallel[title].results) == repr(finished.results)


def test_one_job_and_a_gpu_use_this_process():
    assert default_executor(CPU, 1) is LOCAL
    assert default_executor(torch.device("cuda"), 100) is LOCAL
