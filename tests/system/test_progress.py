"""Progress of long commands where there is no terminal."""

from __future__ import annotations

import io
import re
import time
from pathlib import Path

import pytest
from rich.console import Console
from rich.progress import Progress

import rlbench
from rlbench.apps.render.jobs.render_clips import progress_bar
from rlbench.cli import console as cli
from rlbench.parallel.executor import LOCAL
from rlbench.system.progress import LoggedProgress

DEADLINE_S = 20.0  # until a line must have been written, on a busy machine


@pytest.fixture
def log() -> io.StringIO:
    return io.StringIO()


def wait_for(text: str, read) -> str:
    """What `read` returns once `text` is in it."""
    end = time.monotonic() + DEADLINE_S
    while text not in (found := read()) and time.monotonic() < end:
        time.sleep(0.01)
    assert text in found
    return found


@pytest.mark.parametrize(
    ("total", "resumed", "steps", "line"),
    [
        (200, 0, 5, "city: 25 % done, about 8 min left\n"),  # 150 at 10 in 30 s: 450 s
        (10, 0, 0, "city: 0 % done, time left not known yet\n"),
        (1000, 960, 1, "city: 97 % done, about 90 s left\n"),  # what was done before is no speed
        (10, 0, 1, ""),
    ],
)
def test_a_line_states_the_share_done_and_the_time_left(log, total, resumed, steps, line):
    clock, console = [100.0], Console(file=log)
    bar = LoggedProgress(console=console, get_time=lambda: clock[0], log_period_s=3600.0)
    task = bar.add_task("city", total=total)
    bar.update(task, completed=resumed)
    for _ in range(steps):
        clock[0] += 30
        bar.advance(task, 10)
    bar.print_status()
    assert log.getvalue() == line


def test_lines_come_by_themselves_until_the_end(log):
    with LoggedProgress(console=Console(file=log), log_period_s=0.01) as bar:
        bar.add_task("a long cell", total=2)
        wait_for("a long cell: 0 % done", log.getvalue)
    written = log.getvalue()
    time.sleep(0.1)
    assert log.getvalue() == written


def test_an_error_ends_the_lines(log):
    bar = LoggedProgress(console=Console(file=log), log_period_s=0.01)
    with pytest.raises(ZeroDivisionError), bar:
        raise ZeroDivisionError
    assert not bar._thread.is_alive()


def test_a_terminal_gets_the_bar_and_no_lines(log):
    terminal = Console(file=log, force_terminal=True, force_interactive=True)
    with LoggedProgress(console=terminal, log_period_s=0.01) as bar:
        bar.add_task("city", total=2)
        time.sleep(0.1)
    assert "% done" not in log.getvalue()


@pytest.mark.parametrize(
    ("open_bar", "description"),
    [
        (lambda: progress_bar(LOCAL), "city"),
        (lambda: cli.training("ours", 100), "ours"),
        (lambda: cli.counting("importing", 3), "importing"),
    ],
    ids=["render", "train", "import"],
)
def test_commands_write_lines_where_nothing_can_be_drawn(
    open_bar, description, monkeypatch, capsys
):
    monkeypatch.setitem(LoggedProgress.__init__.__kwdefaults__, "log_period_s", 0.01)
    written: list[str] = []

    def read() -> str:
        written.append(capsys.readouterr().err)
        return "".join(written)

    with open_bar() as bar:
        if isinstance(bar, Progress):
            bar.add_task(description, total=4)
        wait_for(f"{description}: 0 % done", read)


def test_every_bar_of_the_package_is_a_logged_one():
    files = Path(rlbench.__file__).parent.rglob("*.py")
    opened = re.compile(
        r"import .*\btrack\b|(?<!Logged)(?<!Training)\bProgress\(\s*\*|with Progress\("
    )
    own = Path("system") / "progress.py"
    assert not [f for f in files if not f.match(str(own)) and opened.search(f.read_text())]
