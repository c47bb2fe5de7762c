"""The words of a decision: the answer, how sure it is, what would change it, its limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from reports.analysis.differences import (
    VERDICT_NOTE,
    describe_difference,
    holm_mark,
)
from reports.analysis.intervals import Interval
from reports.decide import BreakEven, Candidate, Decision
from reports.layout.tables import CLAIMED_MARK, score_name
from rlbench.benchmark.results import mark_uncertainty, uncertainty

LISTED = 8  # methods in the table
NAMED = 4  # methods that a sentence names
INPUTS = {"sample_ms": "a sample costs", "frame_ms": "the deadline is"}
NEAR = 1.2  # factor between two costs of a sample that may be of one device and size


def decision_text(decision: Decision, next_run: str = "") -> str:
    """Lines for people: the answer, how sure it is, what would change it, its limits.

    `next_run` is a command that measures a larger budget of the winner, if there is one.
    """
    return "\n".join(
        [
            *_mixed(decision),
            *_answer(decision, next_run),
            "",
            *_aligned(list(_table(decision))),
            "",
            "What would change the answer:",
            *(f"  {_change(change, decision)}" for change in decision.changes),
            "",
            *_basis(decision),
        ]
    )


def _mixed(decision: Decision) -> Iterator[str]:
    """A line that says whether times of a sample and of inference belong together; or none."""
    ratio = decision.measured_sample_ms / decision.sample_ms
    is_far = ratio > NEAR or ratio < 1 / NEAR
    if is_far:
        yield (
            f"Warning: {decision.sample_ms:g} ms a sample is probably of another device or size "
            f"than inference, of {_device(decision)} at {_size(decision)}: there a sample takes "
            f"{decision.measured_sample_ms:.3g} ms ({decision.measured_sample_source})."
        )
    elif decision.device_mixes:
        yield f"Warning, two devices: {'; '.join(decision.device_mixes)}."
    if is_far or decision.device_mixes:
        yield (
            "No machine has these frame times. Measure inference where samples were timed: "
            "rlbench speed --as-cost, then decide with --cost."
        )


def _answer(decision: Decision, next_run: str) -> Iterator[str]:
    best, *others = decision.candidates
    yield (
        f"{best.method} at {best.spp:.3g} spp: {_metric(decision)} "
        f"{_number(best.value.mean, decision)} {decision.unit}".rstrip()
        + f" {_ends(best.value, decision)} over "
        f"{len(decision.scenes)} scene{'s' * (len(decision.scenes) != 1)}, in {best.frame_ms:.3g} "
        f"of {decision.frame_ms:g} ms ({best.gbuffer_ms:.3g} G-buffer + "
        f"{best.inference_ms:.3g} inference + {best.sampling_ms:.3g} sampling)."
    )
    if decision.could_win:
        yield (
            f"Times here are uncertain by {100 * decision.uncertainty:.0f} %: "
            f"{_join(decision.could_win)} could take its place."
        )
    if best.is_largest_budget:
        measure = f" Measure it: {next_run}" * bool(next_run)
        yield f"{best.spp:g} spp is its largest measured budget: more may fit.{measure}"
    if (raw := decision.undenoised) is not None:
        yield (
            f"Without a denoiser, {raw.method} at {raw.spp:.3g} spp has "
            f"{_number(raw.value.mean, decision)} {decision.unit}".rstrip()
            + f" in {raw.frame_ms:.3g} ms."
        )
    if not others:
        yield "No other method fits."
        return
    gap = describe_difference(others[0].difference, decision.unit, decision.direction)
    mark = holm_mark(others[0].verdict, others[0].p_holm)
    yield f"Runner-up: {others[0].method} at {others[0].spp:.3g} spp: {gap}{mark}."


def _table(decision: Decision) -> Iterator[tuple[str, ...]]:
    unit = f" [{decision.unit}]" * bool(decision.unit)
    yield ("method", "spp", "frame ms", _metric(decision) + unit, "difference", "")
    for row in decision.candidates[:LISTED]:
        gap = row.difference
        difference = f"{_number(gap.mean, decision, '+')} {_ends(gap, decision, '+')}".strip()
        yield (
            row.method,
            f"{row.spp:.3g}",
            f"{row.frame_ms:.3g}{_mark_time(row)}",
            _number(row.value.mean, decision),
            "" if row is decision.candidates[0] else difference,
            row.verdict + holm_mark(row.verdict, row.p_holm),
        )


def _mark_time(row: Candidate) -> str:
    """The uncertainty of a frame time, and the mark of one that is claimed."""
    share = uncertainty(row.frame_ms, row.low_ms, row.high_ms)
    return mark_uncertainty(share) + CLAIMED_MARK * row.is_claimed


def _join(names: Sequence[str]) -> str:
    """The first names of a list, and how many more there are."""
    more = f" and {len(names) - NAMED} more" * (len(names) > NAMED)
    return f"{', '.join(names[:NAMED])}{more}"


def _change(change: BreakEven, decision: Decision) -> str:
    bound = "below" if change.direction == "lower" else "above"
    noun = "cost of a sample" if change.changed == "sample_ms" else "deadline"
    if change.at_ms is None:
        name = decision.candidates[0].method
        return f"{name} wins at any {change.direction} {noun}, up to its measured budgets"
    outcome = f"{change.method} wins" if change.method else "no method fits"
    return f"{outcome} where {INPUTS[change.changed]} {bound} {change.at_ms:.3g} ms"


def _basis(decision: Decision) -> Iterator[str]:
    yield (
        f"Inference (plan + allocate + denoise) was measured on {_device(decision)}, at "
        f"{_size(decision)}; it is not scaled to another device or size. The G-buffer costs as "
        "many samples as in the results, or what --gbuffer-ms says."
    )
    yield (
        f"{_metric(decision)}: {decision.convention}; between measured budgets linear in log spp. "
        f"Differences are paired by scene. {VERDICT_NOTE} Here "
        "these are the methods that fit."
    )
    if any(row.is_claimed for row in decision.candidates[:LISTED]):
        yield f"{CLAIMED_MARK}: images made elsewhere; budget and time are claimed."
    yield from decision.notes


def _device(decision: Decision) -> str:
    return decision.inference_device or "an unnamed device"


def _size(decision: Decision) -> str:
    return ", ".join(decision.image_sizes) or "an image size that these results do not state"


def _metric(decision: Decision) -> str:
    return score_name(decision.metric)


def _number(value: float, decision: Decision, sign: str = "") -> str:
    return f"{value:{sign}{'.2f' if decision.unit == 'dB' else '.3g'}}"


def _ends(interval: Interval, decision: Decision, sign: str = "") -> str:
    if not interval.is_known:
        return ""
    low, high = (_number(end, decision, sign) for end in (interval.low, interval.high))
    return f"[{low}, {high}]"


def _aligned(lines: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides = "<>>><<"
    return [
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(line, sides, widths, strict=True)
        ).rstrip()
        for line in lines
    ]
