"""Gates of speed: the ratio of two rows' inference times, measured in turn on one machine.

A time belongs to a machine, the ratio of two much less so. Both rows run in the same interleaved
rounds (`rlbench.benchmark.clock`) on generated frames, so that a drift of the machine meets both.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rlbench.errors import OptionError, PluginError

if TYPE_CHECKING:
    import torch

    from rlbench.benchmark.latency import Timing
    from rlbench.benchmark.speed import Configuration

__all__ = ["SLOWER", "SpeedGate", "SpeedResult", "judge", "measure_gates", "parse_gate"]

SLOWER, WITHIN, NOT_RESOLVED, UNDECIDED = "slower", "within", "not resolved", "undecided"
REPEATS = 30  # timed frames of a row, at least
SIZE = (192, 192)  # pixels, height and width of the generated frames; that of preset mini


@dataclass(frozen=True)
class SpeedGate:
    """The largest ratio of two inference times that passes."""

    row: str  # name of a row, such as ours or ours@bf16
    reference: str  # name of the row that its time is divided by
    max_ratio: float

    def __str__(self) -> str:
        """The gate as it is written in a baseline."""
        return f"{self.row} / {self.reference} <= {self.max_ratio:g}"


@dataclass(frozen=True)
class SpeedResult:
    """What was measured of a gate."""

    gate: SpeedGate
    verdict: str  # slower, within, not resolved, or undecided
    ratio: float = math.nan  # of the medians
    low: float = math.nan  # ends of an interval that holds the ratio with probability 0.9
    high: float = math.nan
    reason: str = ""  # why it is undecided

    def __str__(self) -> str:
        """The result as one line of text."""
        text = f"speed {self.verdict}: {self.gate}"
        if self.reason:
            return f"{text}: {self.reason}"
        return f"{text}, measured {self.ratio:.3f} [{self.low:.3f}, {self.high:.3f}]"


def parse_gate(text: str) -> SpeedGate:
    """The gate in `A/B<=1.3`, where A and B name rows of installed methods.

    >>> parse_gate("ours/oidn<=1.3")
    SpeedGate(row='ours', reference='oidn', max_ratio=1.3)
    >>> parse_gate("oidn/tuned / oidn <= 1")
    SpeedGate(row='oidn/tuned', reference='oidn', max_ratio=1.0)

    Raises OptionError for another form, an unknown method, or a name that can be split in two ways.
    """
    names, _, limit = text.partition("<=")
    try:
        max_ratio = float(limit)
    except ValueError:
        max_ratio = math.nan
    if not 0 < max_ratio < math.inf:
        raise OptionError(f"'{text}' is no gate. Write A/B<=1.3, for example ours/oidn<=1.3")
    separator = " / " if " / " in names else "/"
    cuts = [match.start() for match in re.finditer(re.escape(separator), names)]
    pairs = [(names[:cut].strip(), names[cut + len(separator) :].strip()) for cut in cuts]
    known = [pair for pair in pairs if all(map(_is_known, pair))]
    if len(known) != 1:
        found = " and ".join(f"'{a}' / '{b}'" for a, b in known) or "no two installed methods"
        raise OptionError(f"'{text}' names {found}. Write two rows with spaces, A / B<=1.3")
    return SpeedGate(*known[0], max_ratio)


def measure_gates(
    gates: Sequence[SpeedGate],
    device: torch.device,
    repeats: int = REPEATS,
    on_done: Callable[[], None] = lambda: None,
) -> list[SpeedResult]:
    """Time the rows of all gates in interleaved rounds, and judge each gate.

    A row that several gates name is timed once. `on_done` is called for each row that is done.
    Raises OptionError for a row that fails.
    """
    from rlbench.benchmark.latency import TimedRow, time_methods
    from rlbench.benchmark.work import SPP, generated_clip

    names = list(dict.fromkeys(name for gate in gates for name in (gate.row, gate.reference)))
    clip = generated_clip(SIZE, device)
    rows = [TimedRow(_configuration(name).load(device), clip, SPP) for name in names]
    timings: dict[str, Timing] = {}
    outcomes = time_methods(rows, device, repeats, on_done=on_done)
    for name, outcome in zip(names, outcomes, strict=True):
        if isinstance(outcome, Exception):
            raise OptionError(
                f"--speed: {name} cannot be timed: {type(outcome).__name__}: {outcome}. Correct "
                "the method, or remove the gate"
            )
        timings[name] = outcome
    return [judge(gate, timings[gate.row], timings[gate.reference]) for gate in gates]


def judge(gate: SpeedGate, row: Timing, reference: Timing) -> SpeedResult:
    """The verdict on a gate: slower only if the whole interval of the ratio exceeds it.

    The ends are those of the clock's 95 % intervals of the two medians, divided. The true ratio is
    below the lower end with probability 0.05 at most (Bonferroni over one end of each), so that is
    how often a gate fails by chance. A ratio of a time that failed its test is refused: undecided.
    """
    for name, timing in ((gate.row, row), (gate.reference, reference)):
        if timing.unreliable:
            reason = f"the time of {name} is unreliable: {timing.unreliable}"
            return SpeedResult(gate, UNDECIDED, reason=reason)
    ratio = row.inference.p50 / reference.inference.p50
    low = ratio * (1 - row.half_width) / (1 + reference.half_width)
    high = ratio * (1 + row.half_width) / (1 - reference.half_width)
    verdict = SLOWER if low > gate.max_ratio else WITHIN if high <= gate.max_ratio else NOT_RESOLVED
    return SpeedResult(gate, verdict, ratio, low, high)


def _configuration(name: str) -> Configuration:
    """The method of a row, with the backend and precision that its label names."""
    from rlbench.benchmark.row_name import RowName
    from rlbench.benchmark.speed import Configuration

    row = RowName.parse(name)
    return Configuration(row.method, row.options.backend, row.options.bf16)


def _is_known(name: str) -> bool:
    """Is this a row of an installed method, with no label of weights or of tiles?

    No generated frame has tiles without changes.
    """
    from rlbench import registry
    from rlbench.benchmark.row_name import RowName

    row = RowName.parse(name)
    try:
        registry.get_variant(row.method)
    except PluginError:
        return False
    return not row.options.weights and not row.options.skip_tiles
