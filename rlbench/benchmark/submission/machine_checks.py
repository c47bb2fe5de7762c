"""What a submission says, judged by the clips, code, weights and metrics that are here."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

from rlbench import registry
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.content_hash import CellIds
from rlbench.benchmark.submission.current import plan_of, uncheckable_methods
from rlbench.benchmark.submission.document import ClipFacts, Submission
from rlbench.checks.result import CheckResult, failed, not_applicable, passed, warning
from rlbench.system import documents

__all__ = ["check_against_machine", "shipped_digests"]

SHIPPED = Path(__file__).parent / "digests.toml"  # a table for each preset
DIGITS = 12  # of a shipped digest


def check_against_machine(
    submission: Submission, clips: Mapping[str, StoredSource]
) -> Iterator[CheckResult]:
    """The results of all checks that compare with what is here; `clips` are those here, by name."""
    yield _check_digests(submission, clips)
    yield _check_metrics(submission)
    yield _check_hashes(submission, "code", lambda row: _hashes(row)[0])
    yield _check_hashes(submission, "weights", lambda row: _hashes(row)[1])


@cache
def shipped_digests(preset: str) -> dict[str, str]:
    """The first 12 digits of the digest of each clip of a preset with its path samples.

    Empty for a preset without a list. The clips are those on which the shipped baseline was
    measured.
    """
    return dict(documents.read_toml(SHIPPED).get(preset, {}))


def _check_digests(submission: Submission, clips: Mapping[str, StoredSource]) -> CheckResult:
    """Are the clips those of this machine, or of the shipped list?"""
    listed = shipped_digests(submission.preset)
    same: list[str] = []
    other: list[str] = []
    traced_alike: list[str] = []
    for facts in submission.clips:
        if facts.name in clips:
            source = clips[facts.name]
            equal = all(_digest(source, pool) == text for pool, text in facts.digests.items())
            (same if equal else other).append(facts.name)
            if not equal and _is_traced_alike(facts, source):
                traced_alike.append(facts.name)
        elif facts.name in listed and "path" in facts.digests:
            equal = facts.digests["path"][:DIGITS] == listed[facts.name]
            (same if equal else other).append(facts.name)
    if traced_alike:
        text = f"{', '.join(traced_alike)} has other pixels here, by the same tracer and processor"
        return failed("clip digests", text, "do not compare: scores are of other clips")
    if other:
        text = f"{', '.join(other)} has other pixels here; another processor rounds differently"
        return warning("clip digests", text, "measure cells again here: rlbench verify --rerun 3")
    if not same:
        return not_applicable(
            "clip digests", "no clip is here or listed; rlbench render makes them"
        )
    unknown = len(submission.clips) - len(same)
    rest = f"; {unknown} others are neither here nor listed" if unknown else ""
    return passed("clip digests", f"{len(same)} clips have the pixels of those here{rest}")


def _digest(source: StoredSource, pool: str) -> str:
    """The digest with a pool; none where the clip here has no such pool."""
    return source.content(pool) if pool in source.header.pools else ""


def _is_traced_alike(facts: ClipFacts, source: StoredSource) -> bool:
    header = source.header
    sampler = f"{header.sampler} {header.sampler_version}".strip()
    has_pools = set(facts.digests) <= set(header.pools)
    return has_pools and (facts.sampler, facts.device) == (sampler, header.device)


def _check_metrics(submission: Submission) -> CheckResult:
    """Do metrics of one name mean the same here?"""
    sizes = {(clip.height, clip.width) for clip in submission.clips}
    here = {
        fitted.name: (fitted.unit, fitted.direction, fitted.convention)
        for metric in registry.load_run_metrics().values()
        for size in sizes
        for fitted in [metric.at(*size)]
    }
    stated = {m.name: (m.unit, m.direction, m.convention) for m in submission.metrics}
    if "psnr" not in stated:
        return failed("metrics", "psnr has no convention", "measure with rlbench run")
    common = sorted(here.keys() & stated.keys())
    if changed := [name for name in common if here[name] != stated[name]]:
        text = f"{', '.join(changed)} have another convention here"
        return failed("metrics", text, "compare with the version that the file names")
    strangers = len(stated) - len(common)
    rest = f"; {strangers} are not known here" if strangers else ""
    return passed("metrics", f"{len(common)} have the conventions of those here{rest}")


def _check_hashes(submission: Submission, what: str, here: Callable[[str], str]) -> CheckResult:
    """Are the hashes of code or weights those of what is installed?"""
    rows = {cell.method for cell in submission.measured}
    unknown = uncheckable_methods(rows)
    other = []
    for row in sorted(rows - set(unknown)):
        stated = {getattr(c, f"{what}_hash") for c in submission.measured if c.method == row}
        if stated != {here(row)}:
            other.append(row)
    if other:
        text = f"{_join(other)} differ from those of rlbench {_version()} here"
        remedy = f"the file is of rlbench {submission.version}, commit {submission.commit or '-'}"
        return warning(what, text, remedy)
    same = len(rows) - len(unknown)
    if not same:
        return not_applicable(what, f"{_join(unknown)}: not installed here, or with other weights")
    rest = f"; not here: {_join(unknown)}" if unknown else ""
    return passed(what, f"{same} rows have the {what} of those here{rest}")


@cache
def _hashes(row: str) -> tuple[str, str]:
    """Hashes of the code and of the weights of a row here."""
    ids = CellIds(plan_of(row, (), (1.0,), (0,)))
    (name,) = ids.plan.methods
    return ids.code_hashes[name], ids.weights_hashes[name]


def _version() -> str:
    from importlib.metadata import version

    return version("rlbench")


def _join(names: Iterable[str]) -> str:
    listed = list(names)
    more = f" and {len(listed) - 4} more" if len(listed) > 4 else ""
    return ", ".join(listed[:4]) + more
