"""Trying claims on methods: one at a time, and all of them with a tick list."""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Iterator
from pathlib import Path

import torch

from rlbench import registry
from rlbench.checks.conformance.checks import CHECKS, Check
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.result import Finding, Verdict, moot, wrong

HOLDS = Finding(Verdict.HOLDS)


def run_check(subject: MethodUnderTest, name: str) -> Finding:
    """What the claim of that name says of a method; each claim is tried once."""
    if name not in subject.told:
        subject.told[name] = _judged(subject, CHECKS[name])
    return subject.told[name]


def run_checks(subject: MethodUnderTest) -> Iterator[tuple[Check, Finding]]:
    """Every claim with what it says, as soon as it is known."""
    for name, claim in CHECKS.items():
        yield claim, run_check(subject, name)


def subjects(patterns: Iterable[str], device: torch.device) -> list[MethodUnderTest]:
    """The methods to examine, by the patterns of `registry.expand`.

    `all` stands for every variant of every family that can be loaded. Raises PluginError for a name
    that is not there.
    """
    sound = [f"{n}/*" for n in registry.names("methods") if not registry.import_error("methods", n)]
    named = [each for pattern in patterns for each in (sound if pattern == "all" else [pattern])]
    return [MethodUnderTest(name, device) for name in registry.expand(named, trained=False)]


def broken() -> dict[str, str]:
    """Families that cannot be loaded, and why."""
    known = {name: registry.import_error("methods", name) for name in registry.names("methods")}
    return {name: why for name, why in known.items() if why}


def _judged(subject: MethodUnderTest, claim: Check) -> Finding:
    if subject.absent:
        return moot(subject.absent)
    for needed in claim.depends_on:
        if run_check(subject, needed).verdict is not Verdict.HOLDS:
            return moot(f"cannot be told unless {CHECKS[needed].sentence}")
    try:
        return claim.test(subject) or HOLDS
    except Exception as error:  # whatever a stranger's method may raise is what is reported
        return wrong(f"{type(error).__name__}: {error}{_place(subject, error)}", error)


def _place(subject: MethodUnderTest, error: Exception) -> str:
    """The last line of the method's own code, or of what it called, that the error went through."""
    frames = traceback.extract_tb(error.__traceback__)
    own = registry.module_file(registry.family(subject.name).build).parent
    theirs = [frame for frame in frames if Path(frame.filename).is_relative_to(own)]
    return f" ({Path(theirs[-1].filename).name}, line {theirs[-1].lineno})" if theirs else ""
