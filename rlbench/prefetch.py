"""Drawing ahead: the next sequence is read and cut while this one is learned from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

from rlbench.clips.in_memory import MemoryClip
from rlbench.training.batches import Batches


@contextmanager
def ahead(batches: Batches) -> Iterator[Callable[[int], MemoryClip]]:
    """`Batches.draw`, one draw ahead of what is asked for, in a thread of its own.

    The draws are the same as without. What stops the reading of a draw is raised when that draw is
    asked for.
    """
    waiting: dict[int, Future[MemoryClip]] = {}
    with ThreadPoolExecutor(1, thread_name_prefix="draw") as reader:

        def draw(index: int) -> MemoryClip:
            asked = waiting.pop(index, None) or reader.submit(batches.draw, index)
            waiting.clear()
            clip = asked.result()
            waiting[index + 1] = reader.submit(batches.draw, index + 1)
            return clip

        yield draw
