"""Questions of a frame: what only its values can tell, answered at once or once after the frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from jaxtyping import Shaped
from torch import Tensor

from rlbench.ops import asking

__all__ = ["Questions"]

Judge = Callable[[list[float]], None]  # raises an error that the values cause, or counts


@dataclass(frozen=True)
class Questions:
    """Checks of a frame's values, such as a valid density or the number of repaired pixels.

    On a CPU each is answered where it is asked. On a GPU, and where a frame is recorded, its few
    numbers stay on the device until `answer`, which reads those of all questions together. An error
    is raised then: until the end of the frame, what follows works with values made valid.

    >>> questions = Questions()
    >>> questions.ask(torch.tensor([3.0]), lambda values: print("found", values))
    found [3.0]
    [3.0]
    """

    _asked: list[tuple[Tensor, Judge]] = field(default_factory=list, init=False)

    def ask(self, values: Shaped[Tensor, " k"], judge: Judge) -> list[float] | None:
        """Hand the values to `judge`, now or later; returns them if it is now.

        Numbers are read in float64, so whole ones are exact up to 2^53. Raises what `judge` raises.
        """
        if not asking.may_ask(values):
            self._asked.append((values, judge))
            return None
        answer: list[float] = values.tolist()
        judge(answer)
        return answer

    def answer(self) -> None:
        """Read all numbers that are left, in one transfer. Raises what the judges raise."""
        pending = self._asked[:]
        self._asked.clear()
        if not pending or asking.is_recording():  # a recording has no answers
            return
        numbers = torch.cat([values.double() for values, _ in pending]).tolist()
        for values, judge in pending:
            judge(numbers[: len(values)])
            del numbers[: len(values)]
