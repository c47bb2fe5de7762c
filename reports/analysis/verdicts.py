"""What a difference between two methods is called: leads, trails, tie, or not resolved."""

from __future__ import annotations

from reports.analysis.intervals import INTERVAL_NOTE, Interval

__all__ = [
    "HOLM_MARK",
    "LEADS",
    "NOT_RESOLVED",
    "TIE",
    "TIE_DB",
    "TRAILS",
    "VERDICT_NOTE",
    "describe_difference",
    "name_verdict",
]

TIE_DB = 0.1  # of PSNR; a smaller difference matters to nobody
LEADS, TRAILS, TIE, NOT_RESOLVED = "leads", "trails", "tie", "not resolved"
HOLM_MARK = "†"  # after a difference that is resolved by itself, but not after the correction
VERDICT_NOTE = (
    f"Brackets: {INTERVAL_NOTE}. Tie: the interval lies within +-{TIE_DB:g} dB. Not resolved: it "
    "reaches further and includes zero. Otherwise one method leads; "
    f"{HOLM_MARK}: not after Holm's correction."
)


def name_verdict(gap: Interval, unit: str, direction: str = "higher") -> str:
    """The verdict on the method whose score minus that of another is `gap`; "" without an interval.

    The printed 95 % interval decides all. Within +-0.1 dB it is a tie: two one-sided tests at 2.5 %
    reject both larger differences (Schuirmann 1987; Lakens 2017), as strictly as a lead is tested.
    Other units have no margin, so no ties. `direction` says whether "higher" or "lower" is better.

    >>> name_verdict(Interval(0.2, -0.1, 0.5, 4), "dB")
    'not resolved'
    >>> name_verdict(Interval(0.2, 0.1, 0.3, 4), "", "lower")
    'trails'
    """
    if not gap.is_known:
        return ""
    if unit == "dB" and gap.is_within(TIE_DB):
        return TIE
    if not gap.excludes_zero:
        return NOT_RESOLVED
    return LEADS if (gap.mean > 0) == (direction != "lower") else TRAILS


def describe_difference(gap: Interval, unit: str, direction: str = "higher") -> str:
    """The verdict with its figures, for sentences.

    >>> describe_difference(Interval(-0.2, -0.3, -0.1, 4), "dB")
    'trails by 0.20 dB [0.10, 0.30]'
    >>> describe_difference(Interval(0.2, -0.1, 0.5, 4), "dB")
    'not resolved, +0.20 dB [-0.10, +0.50]'
    >>> describe_difference(Interval(0.2, float("nan"), float("nan"), 1), "dB")
    '+0.20 dB, no interval: one clip'
    """
    digits = ".2f" if unit in ("dB", "ms") else ".3g"
    verdict = name_verdict(gap, unit, direction)
    ends = f"[{gap.low:+{digits}}, {gap.high:+{digits}}]"
    signed = f"{gap.mean:+{digits}} {unit}".strip()
    if not verdict:
        return f"{signed}, no interval: one clip"
    if verdict in (TIE, NOT_RESOLVED):
        return f"{verdict}, {signed} {ends}"
    low, high = sorted((abs(gap.low), abs(gap.high)))
    size = f"{abs(gap.mean):{digits}} {unit}".strip()
    return f"{verdict} by {size} [{low:{digits}}, {high:{digits}}]"
