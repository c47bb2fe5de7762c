"""One bad pixel: does a single bad value stay where it is, and is it gone after a few frames?

Frame 2 of a moving procedural clip gets one bad value in a sample, in a buffer or in the state. The
images are compared with those of a run without it for seven frames. A legal change at the same
place is the control: the brightest stored sample of the pixel or a black one, the buffer of
background, or another pixel's state. Methods that place their samples run with the sample counts of
the clean run, and with free counts, in which the fault may also move samples: images are then
equally good rather than equal.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rlbench.checks.result import CheckResult, Limits, Verdict, judge
from rlbench.checks.stress.faults import (
    MAX_CHANGED,
    TOLERANCE,
    VALUES,
    Blast,
    CleanRun,
    Fault,
    run_clean,
)
from rlbench.checks.stress.section import MethodSection, StressedMethod
from rlbench.frames import Size
from rlbench.sanitize import read_unsanitized

SIZE, QUICK_SIZE = Size(1, 64, 64), Size(1, 48, 48)
QUICK_VALUES = ("nan", "65504")
FREE_VALUES = ("nan", "65504", "minus-one")  # also with free counts, and without sanitising
EQUALLY_GOOD = 0.1  # dB: other samples of the same budget move the PSNR of a frame by as much
NOTICEABLE = 1.0  # dB
CHANGED = Limits(good=float(MAX_CHANGED), unit="pixels")
SHARE = Limits(good=100.0, fair=0.0, unit="%")  # without the core's help: never a failure
VISIBLE = 1 / 255  # a residue below one step of an 8-bit display is degraded, not failed
REMEDIES = {
    "sample": "limit outliers before they are accumulated, exposed or filtered "
    "(rlbench.ops.limit_fireflies)",
    "state": "treat history that is not finite or out of range as missing when it is reprojected",
    "buffer": "read depth, normals and albedo through bounded functions (rlbench.ops.sanitize)",
    "counts": "plan each pixel's density from its neighbourhood, not from statistics of the image",
    "raw": "sanitise in the method (rlbench.ops.sanitize), for use outside the suite",
}


def run(stressed: StressedMethod, is_quick: bool) -> Iterator[CheckResult]:
    """One result per planted fault, and one for all of them without the core's sanitising."""
    clean = run_clean(stressed, QUICK_SIZE if is_quick else SIZE)
    is_adaptive = stressed.traits.adaptive
    legal = {target: clean.repeat_legal(target, is_adaptive) for target in clean.targets}
    for target in clean.targets:
        for value in QUICK_VALUES if is_quick else VALUES:
            yield _judge(clean, clean.plant(target, value), legal[target], is_adaptive)
        if is_adaptive:
            moving = clean.repeat_legal(target, holds_counts=False)
            for value in QUICK_VALUES if is_quick else FREE_VALUES:
                yield _judge(clean, clean.plant(target, value), moving, holds_counts=False)
    if not is_quick:
        yield _judge_unsanitized(clean, legal)


def _judge(clean: CleanRun, fault: Fault, legal: Blast, holds_counts: bool) -> CheckResult:
    moves_samples = clean.stressed.traits.adaptive and not holds_counts
    test = f"{fault.target}-{fault.value}" + ("-free" if moves_samples else "")
    kind = fault.target if fault.target in REMEDIES else "buffer"
    remedy = REMEDIES["counts" if moves_samples else kind]
    try:
        blast = clean.repeat(fault, holds_counts)
    except Exception as error:  # e.g. a density that is not finite
        found = f"raised {type(error).__name__}: {error}"
        return CheckResult(test, Verdict.FAILED, found, remedy, limits=Limits(unit=CHANGED.unit))
    verdict = _verdict_of_loss(blast, legal) if moves_samples else _verdict(blast, legal)
    found = f"{blast}; {blast.loss:.2f} dB lost" if moves_samples else str(blast)
    if not blast.is_contained():
        found += f"; a legal change: {legal}"
    remedy = "" if verdict is Verdict.PASSED else remedy
    return CheckResult(test, verdict, found, remedy, blast.changed_pixels, CHANGED)


def _verdict(blast: Blast, legal: Blast) -> Verdict:
    """Failed if pixels are lost, or if the fault outlives six frames more than a legal change."""
    if blast.is_contained(legal):
        return Verdict.PASSED
    is_lasting = blast.residue > VISIBLE and blast.residue > TOLERANCE * legal.residue
    return Verdict.FAILED if blast.nonfinite or is_lasting else Verdict.WARNING


def _verdict_of_loss(blast: Blast, legal: Blast) -> Verdict:
    """Samples moved: what counts is whether any image lost quality."""
    if blast.is_contained(legal) or blast.loss <= max(EQUALLY_GOOD, TOLERANCE * legal.loss):
        return Verdict.PASSED
    return Verdict.WARNING if blast.loss <= NOTICEABLE else Verdict.FAILED


def _judge_unsanitized(clean: CleanRun, legal: Mapping[str, Blast]) -> CheckResult:
    """How many faults of samples and buffers the method contains without the core's help."""
    faults = [clean.plant(t, v) for t in clean.targets for v in FREE_VALUES if t != "state"]
    contained = sum(_is_contained_unsanitized(clean, f, legal[f.target]) for f in faults)
    found = f"{contained} of {len(faults)} faults are contained if the suite repairs nothing"
    return judge("unsanitized", 100 * contained / len(faults), SHARE, found, REMEDIES["raw"])


def _is_contained_unsanitized(clean: CleanRun, fault: Fault, legal: Blast) -> bool:
    try:
        blast = clean.repeat(fault, clean.stressed.traits.adaptive, read_unsanitized)
    except Exception:  # e.g. a density that is not finite
        return False
    return blast.is_contained(legal)


SECTION = MethodSection(run)
