"""Sections are found by name; every job has results, and finished jobs are reused."""

from __future__ import annotations

import json
import sys

import pytest
import torch

from rlbench import registry
from rlbench.checks.result import Verdict
from rlbench.checks.stress.jobs import (
    StressJob,
    content_hash,
    default_executor,
    plan_jobs,
    run_jobs,
    write_results,
)
from rlbench.checks.stress.section import list_sections, load_section, select_sections
from rlbench.errors import PluginError
from rlbench.parallel.executor import LOCAL
from rlbench.parallel.process_executor import ProcessExecutor
from tests.conftest import install_plugin, write_plugin

CPU = torch.device("cpu")
EMPTY_SECTION = """
from rlbench.checks.stress.section import SuiteSection
SECTION = SuiteSection(lambda is_quick: iter(()))
"""


def jobs_of(*methods, only=("budgets",)):
    return plan_jobs(methods, only, True, CPU)


def run(jobs, folder, **options):
    return {finished.job.title: finished for finished in run_jobs(jobs, folder, **options)}


def use_toy(folder, name="toy", **options):
    registry.use_plugin(write_plugin(folder / f"{name}.py", name, **options))


def test_jobs_of_the_suite_come_once_and_first():
    jobs = plan_jobs(["mean", "svgf"], ["budgets", "metrics"], False, CPU)
    assert [job.title for job in jobs] == ["metrics", "mean: budgets", "svgf: budgets"]


def test_a_finished_job_is_not_run_again_before_a_restart_or_a_change(tmp_path):
    use_toy(tmp_path)
    (job,), title = jobs_of("toy"), "toy: budgets"
    first, second = run([job], tmp_path)[title], run([job], tmp_path)[title]
    assert (first.is_stored, second.is_stored) == (False, True)
    assert repr(second.results) == repr(first.results)  # with nan
    assert not run([job], tmp_path, is_restart=True)[title].is_stored
    (full,) = plan_jobs(["toy"], ["budgets"], False, CPU)
    assert content_hash(full) != content_hash(job)
    file = tmp_path / "toy.py"
    file.write_text(f"{file.read_text()}\n# changed\n")
    assert not run([job], tmp_path)[title].is_stored


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


@pytest.mark.parametrize(
    ("build", "found"),
    [
        ("raise OSError('no licence')", "raised OSError: no licence"),
        ("raise SystemExit('bye')", "raised PluginExitError: plugin code called sys.exit('bye')"),
    ],
)
def test_a_method_that_cannot_be_built_fails_each_time_and_the_others_run(tmp_path, build, found):
    use_toy(tmp_path, build=build)
    finished = run(jobs_of("toy", "mean"), tmp_path)
    (result,) = finished["toy: budgets"].results
    assert result.verdict is Verdict.FAILED
    assert found in result.found
    assert "(toy.py:" in result.found
    assert len(finished["mean: budgets"].results) > 5
    assert not run(jobs_of("toy"), tmp_path)["toy: budgets"].is_stored


@pytest.mark.parametrize(
    ("method", "reason"),
    [("nppd/large", "has no shipped weights"), ("toy", "pip install no-such-package")],
)
def test_a_method_that_cannot_run_here_is_skipped(tmp_path, method, reason):
    use_toy(tmp_path)
    file = tmp_path / "toy.py"
    requires = "learned=False, requires=('no-such-package',)"
    file.write_text(file.read_text().replace("learned=False", requires))
    (result,) = run(jobs_of(method), tmp_path)[f"{method}: budgets"].results
    assert result.verdict is Verdict.SKIPPED
    assert reason in result.found


def run_section(folder, monkeypatch, *lines):
    """The finished jobs of two methods under a section of these lines."""
    install_section(folder, monkeypatch, "new", "\n".join(lines))
    return run(jobs_of("mean", "svgf", only=("new",)), folder)


def test_a_section_that_cannot_be_imported_fails_once(tmp_path, monkeypatch):
    finished = run_section(tmp_path, monkeypatch, "1 / 0")
    assert list(finished) == ["new"]
    (result,) = finished["new"].results
    assert result.verdict is Verdict.FAILED
    assert "ZeroDivisionError" in result.found


def test_results_before_an_exception_of_a_section_are_kept(tmp_path, monkeypatch):
    finished = run_section(
        *(tmp_path, monkeypatch),
        "from rlbench.checks.result import not_applicable",
        "from rlbench.checks.stress.section import MethodSection",
        "def run(stressed, is_quick):",
        "    yield not_applicable('first', 'no reason')",
        "    raise KeyError('second')",
        "SECTION = MethodSection(run)",
    )
    results = [(r.check, r.verdict) for r in finished["mean: new"].results]
    assert results == [("first", Verdict.SKIPPED), ("run", Verdict.FAILED)]


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


# sections


@pytest.mark.parametrize("name", list_sections())
def test_every_section_can_be_loaded(name):
    assert callable(load_section(name).run)


def test_selected_sections_keep_the_order_of_the_suite():
    assert select_sections(["metrics", "budgets"]) == ["budgets", "metrics"]
    assert select_sections() == list(list_sections())


def install_section(folder, monkeypatch, name, content):
    """A package that registers the stress section `name`."""
    (folder / "new_section.py").write_text(content)
    install_plugin(folder, monkeypatch, "stress", f"{name} = new_section:SECTION")
    monkeypatch.delitem(sys.modules, "new_section", raising=False)  # that of another test


def test_a_section_of_a_plugin_is_listed_last(tmp_path, monkeypatch):
    install_section(tmp_path, monkeypatch, "zebra", EMPTY_SECTION)
    assert list(list_sections())[-1] == "zebra"
    assert list(load_section("zebra").run(True)) == []


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("budgets", EMPTY_SECTION, "has the name of a section of rlbench"),
        ("zebra", "SECTION = 'zebra'", "an object of type str"),
    ],
)
def test_a_plugin_that_is_no_section_of_its_own_is_refused(
    tmp_path, monkeypatch, name, content, problem
):
    install_section(tmp_path, monkeypatch, name, content)
    with pytest.raises(PluginError, match=problem):
        load_section(name)
