"""Limitations that a clip declares: what it does not have is a warning, not a failure."""

from __future__ import annotations

from dataclasses import replace

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.result import CheckResult, Verdict
from rlbench.clips.header import BUFFER_CHANNELS, Header

__all__ = ["excuse_declared", "without_stand_ins"]

EXCUSED = {  # the checks that fail because of a limitation
    "halves": ("reference halves", "sample independence"),
    "independence": ("sample independence", "noise pattern", "independent seeds"),
    "linear": ("exposure", "brightness", "albedo", "sample independence", "reference halves"),
    "flow": ("motion",),
    **{name: (name, "orientation") for name in BUFFER_CHANNELS},
    "depth": ("depth", "normal", "orientation"),  # the background of one is compared with the other
    "normal": ("normal", "depth", "orientation"),
}


def without_stand_ins(arrays: ClipArrays) -> ClipArrays:
    """The arrays without buffers that are constants because the source had none."""
    absent = {name for name in arrays.gbuffer if f"no {name}" in arrays.header.limitations}
    gbuffer = {name: image for name, image in arrays.gbuffer.items() if name not in absent}
    return replace(arrays, gbuffer=gbuffer)


def excuse_declared(result: CheckResult, header: Header) -> CheckResult:
    """A warning in place of a failure that a declared limitation explains; else the result."""
    declared = [name for name in header.limitations if result.check in EXCUSED.get(name, ())]
    if result.verdict is not Verdict.FAILED or not declared:
        return result
    names = ", ".join(f"'{name}'" for name in declared)
    found = f"{result.found} (limitation {names} of clip.toml)"
    return replace(result, verdict=Verdict.WARNING, found=found)
