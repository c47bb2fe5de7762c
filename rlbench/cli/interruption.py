"""What is said when a command is stopped from outside: by Ctrl-C, or by a reader that went away."""

from __future__ import annotations

import os
import select
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = [
    "INTERRUPTED",
    "PIPE_CLOSED",
    "is_broken_pipe",
    "is_output_closed",
    "silence_output",
    "what_is_kept",
]

INTERRUPTED, PIPE_CLOSED = 130, 141  # exit codes of shells: 128 + SIGINT, 128 + SIGPIPE
KEPT = {  # command: what an interrupted one leaves; None in place of a folder: it has a default
    "render": "finished frames are kept in the cache",
    "render-scene": "finished frames are kept",
    "import": "finished frames are kept in {out}",
    "stress": "finished sections are kept in {out}",
    "train": "clips are kept in the cache and checkpoints in {out}",
    "crossval": "finished cells and the checkpoints of trainings are kept in {out}",
    "run": "finished cells are kept in {out}",
    "evaluate": "finished scores are kept in {out}",
    "scenes": "complete files are kept",
    "video": "complete videos are kept",
}
BEGINS_AGAIN = {"video"}  # commands of KEPT that use nothing of what is there


def what_is_kept(command: str, parameters: Mapping[str, Any]) -> str:
    """What an interrupted command leaves, and how to continue it.

    >>> what_is_kept("run", {"out": "results"}).partition(" The same")[0]
    'interrupted: finished cells are kept in results.'
    """
    if command not in KEPT:
        return "interrupted: nothing was kept"
    out = parameters.get("out") or Path(str(parameters.get("results"))) / "evaluated"
    again = shlex.join(["rlbench", *sys.argv[1:]])
    goes_on = "begins again" if command in BEGINS_AGAIN else "continues"
    return f"interrupted: {KEPT[command].format(out=out)}. The same command {goes_on}: {again}"


def is_broken_pipe(error: BaseException) -> bool:
    """Does an error say that the reader of standard output went away, as in `rlbench list | head`?

    `rich` exits on a broken pipe, and has redirected the output by then.
    """
    chain: list[BaseException] = [error]
    while (cause := chain[-1].__cause__ or chain[-1].__context__) and cause not in chain:
        chain.append(cause)
    is_exit_of_rich = any(isinstance(each, SystemExit) for each in chain)
    has_broken = any(isinstance(each, BrokenPipeError) for each in chain)
    return has_broken and (is_exit_of_rich or is_output_closed())


def is_output_closed() -> bool:
    """Has the reader of standard output gone away?"""
    poll = select.poll()
    try:
        poll.register(sys.__stdout__.fileno() if sys.__stdout__ else 1, select.POLLOUT)
        return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
    except (OSError, ValueError):  # no such file: closed by the caller
        return False


def silence_output() -> None:
    """Write nothing more to standard output, not even when Python ends."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)
