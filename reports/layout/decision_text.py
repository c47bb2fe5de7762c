"""A decision as text: the answer first, then how sure it is, what would change it, its limits."""

from __future__ import annotations

from collections.abc import Iterator

from reports.analysis.decision import BreakEven, Candidate, Decision
from reports.analysis.intervals import LEVEL, Interval
from reports.analysis.verdicts import HOLM_MARK, LEADS, TRAILS, VERDICT_NOTE, describe_difference

__all__ = ["decision_text"]

LISTED = 8  # methods in the table
INPUTS = {"sample_ms": "a sample costs", "frame_ms": "the deadline is"}
NEAR = 1.2  # factor between two costs of a sample that may be of one device and size


def decision_text(decision: Decision, sample_device: str = "") -> str:
    """Lines for people. `sample_device` is the device of `decision.sample_ms`, if it is known."""
    return "\n".join(
        [
            *_answer(decision),
            "",
            *_aligned(list(_table(decision))),
            "",
            "What would change the answer:",
            *(f"  {_change(change, decision)}" for change in decision.changes),
            "",
            *_basis(decision, sample_device),
        ]
    )


def _answer(decision: Decision) -> Iterator[str]:
    best, *others = decision.candidates
    yield (
        f"{best.method} at {best.spp:.3g} spp: {_metric(decision)} "
        f"{_number(best.value.mean, decision)} {_ends(best.value, decision)} over "
        f"{len(decision.scenes)} scene{'s' * (len(decision.scenes) != 1)}, in {best.frame_ms:.3g} "
        f"of {decision.frame_ms:g} ms ({best.inference_ms:.3g} inference + "
        f"{best.sampling_ms:.3g} sampling)."
    )
    if best.is_largest_budget:
        yield (
            f"{best.spp:g} spp is its largest measured budget: more may fit. "
            f"Measure it: rlbench run -m {best.method} --spp {2 * best.spp:g}"
        )
    if others:
        yield _runner_up(others[0], decision)
    else:
        yield "No other method fits."


def _runner_up(rival: Candidate, decision: Decision) -> str:
    difference = describe_difference(rival.difference, decision.unit, decision.direction)
    return f"Runner-up: {rival.method} at {rival.spp:.3g} spp: {difference}{_mark(rival)}."


def _table(decision: Decision) -> Iterator[tuple[str, ...]]:
    unit = f" [{decision.unit}]" * bool(decision.unit)
    yield ("method", "spp", "frame ms", _metric(decision) + unit, "difference", "")
    for row in decision.candidates[:LISTED]:
        gap = row.difference
        difference = ""
        if row is not decision.candidates[0]:
            difference = f"{_number(gap.mean, decision, '+', '')} {_ends(gap, decision, '+', '')}"
        yield (
            row.method,
            f"{row.spp:.3g}",
            f"{row.frame_ms:.3g}",
            _number(row.value.mean, decision, unit=""),
            difference.strip(),
            row.verdict + _mark(row),
        )


def _mark(row: Candidate) -> str:
    """The mark of a lead that Holm's correction takes away."""
    return HOLM_MARK * (row.verdict in (LEADS, TRAILS) and row.p_holm > 1 - LEVEL)


def _change(change: BreakEven, decision: Decision) -> str:
    bound = "below" if change.direction == "lower" else "above"
    noun = "cost of a sample" if change.changed == "sample_ms" else "deadline"
    if change.at_ms is None:
        name = decision.candidates[0].method
        return f"{name} wins at any {change.direction} {noun}, up to its measured budgets"
    outcome = f"{change.method} wins" if change.method else "no method fits"
    return f"{outcome} where {INPUTS[change.changed]} {bound} {change.at_ms:.3g} ms"


def _basis(decision: Decision, sample_device: str) -> Iterator[str]:
    size = ", ".join(decision.image_sizes) or "an image size that these results do not state"
    device = decision.inference_device or "an unnamed device"
    yield (
        f"Inference (plan + allocate + denoise) was measured on {device}, at {size}; "
        "it is not scaled to another device or size."
    )
    if sample_device and sample_device != device:
        yield (
            f"Warning: a sample costs {decision.sample_ms:g} ms on {sample_device}, another device "
            "than that of inference. Measure both on one: rlbench run, there"
        )
    elif not sample_device and not _is_near(decision):
        yield (
            f"Warning: these results charge {decision.measured_sample_ms:.3g} ms for a sample "
            f"({decision.measured_sample_source}), so {decision.sample_ms:g} ms is probably of "
            "another device or size than inference. Measure both on one: rlbench run, there"
        )
    yield (
        f"{_metric(decision)}: {decision.convention}; between measured budgets linear in log spp. "
        f"Differences are paired by scene. {VERDICT_NOTE} It is for all "
        "methods that fit."
    )
    yield from decision.notes


def _is_near(decision: Decision) -> bool:
    ratio = decision.measured_sample_ms / decision.sample_ms
    return not (ratio > NEAR or ratio < 1 / NEAR)  # true where there is nothing to compare with


def _metric(decision: Decision) -> str:
    return "PSNR" if decision.metric == "psnr" else decision.metric


def _number(value: float, decision: Decision, sign: str = "", unit: str | None = None) -> str:
    unit = decision.unit if unit is None else unit
    return f"{value:{sign}{'.2f' if decision.unit == 'dB' else '.3g'}} {unit}".strip()


def _ends(interval: Interval, decision: Decision, sign: str = "", unit: str | None = "") -> str:
    if interval.low != interval.low:
        return ""
    low, high = (_number(end, decision, sign, unit) for end in (interval.low, interval.high))
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
