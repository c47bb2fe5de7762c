"""Errors of Blender's process: missing bpy, rejected job, crash."""

import os
import sys

import pytest

from rlbench.render.cycles import process
from rlbench.render.cycles.process import CyclesError


@pytest.fixture
def python(tmp_path, monkeypatch):
    """Replaces the Python that has bpy by a script, which can die in other ways."""

    def install(body):
        script = tmp_path / "python"
        script.write_text(f"#!/bin/sh\n{body}\n")
        script.chmod(0o755)
        monkeypatch.setenv(process.PYTHON_VARIABLE, str(script))

    return install


def events(tmp_path, job=None):
    return list(process.run_worker(job or {}, tmp_path / "logs" / "render.log"))


@pytest.mark.parametrize(
    ("signal", "why"),
    [("SEGV", "segmentation fault"), ("KILL", "ran out of memory"), ("ABRT", "aborted")],
)
def test_the_error_of_a_crash_has_the_signal_and_the_end_of_the_log(python, tmp_path, signal, why):
    python(f"echo 'BVH build of Suzanne' >&2; kill -{signal} $$")
    with pytest.raises(CyclesError, match=f"(?s)SIG{signal}.*{why}.*BVH build of Suzanne"):
        events(tmp_path)


def test_an_end_before_it_is_done_is_an_error_even_with_exit_code_zero(python, tmp_path):
    python("""echo '{"event": "hello", "blender": "4.5"}'""")
    with pytest.raises(CyclesError, match="exit code 0 before it was done"):
        events(tmp_path)


def test_half_a_line_of_a_process_that_died_is_no_event(python, tmp_path):
    python("""printf '{"event": "ma'; kill -SEGV $$""")
    with pytest.raises(CyclesError, match="SIGSEGV"):
        events(tmp_path)


def test_events_arrive_in_order(python, tmp_path):
    python("""echo '{"event": "made", "file": "a", "seconds": 1}'; echo '{"event": "done"}'""")
    assert [event["event"] for event in events(tmp_path)] == ["made", "done"]


def test_the_error_of_a_missing_interpreter_names_the_variable(tmp_path, monkeypatch):
    monkeypatch.setenv(process.PYTHON_VARIABLE, str(tmp_path / "none"))
    with pytest.raises(CyclesError, match=f"{process.PYTHON_VARIABLE}: .*none cannot be run"):
        events(tmp_path)


def test_a_missing_interpreter_has_no_bpy(tmp_path, monkeypatch):
    monkeypatch.setenv(process.PYTHON_VARIABLE, str(tmp_path / "none"))
    assert process.bpy_version() is None


def test_the_error_of_a_python_without_bpy_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setenv(process.PYTHON_VARIABLE, sys.executable)
    if process.bpy_version():
        pytest.skip("this Python has bpy")
    with pytest.raises(CyclesError, match=r"rlbench\[cycles\]"):
        events(tmp_path)


def test_a_caller_that_stops_listening_ends_the_process(python, tmp_path):
    python(f"""echo $$ > {tmp_path}/pid; echo '{{"event": "made"}}'; exec sleep 60""")
    listening = process.run_worker({}, tmp_path / "render.log")
    next(listening)
    listening.close()
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
