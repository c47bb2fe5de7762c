"""What a submission says, judged by itself: hash, budgets, completeness, and plausible numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from itertools import product

from rlbench.benchmark.submission.document import Submission, SubmittedCell, content_hash
from rlbench.checks.result import CheckResult, failed, not_applicable, passed, warning

__all__ = ["check_content"]

CEILING_TOLERANCE_DB = 0.5  # the noise of a ceiling, which is an estimate from two half references
# psnr, psnr_debiased and the ceiling are three views of one error; clipping makes them differ by
# 0.12 dB at most on preset mini (480 frames of mean, svgf, accumulate/contrast and restir)
IDENTITY_TOLERANCE_DB = 0.5
TIME_TOLERANCE = 1e-6  # relative, of sums of float64
SUMS = {
    "frame_ms": ("gbuffer_ms", "plan_ms", "allocate_ms", "sampling_ms", "denoise_ms"),
    "inference_ms": ("plan_ms", "allocate_ms", "denoise_ms"),
}
LIMITS = {  # of a score in one frame
    "psnr": (0.0, 100.0),
    "psnr_debiased": (-10.0, 100.0),
    "ssim": (-1.0, 1.0),
    "ms_ssim": (-1.0, 1.0),
    "flip": (0.0, 1.0),
    "at_cap": (0.0, 100.0),
    "relmse": (0.0, math.inf),
    "relmse_trimmed": (0.0, math.inf),
    "smape": (0.0, 1.0),
    "flicker": (0.0, math.inf),
    "warped_error": (0.0, math.inf),
    "blotches": (0.0, math.inf),
    "effort_error": (-1.0, 1.0),
    "effort_noise": (-1.0, 1.0),
}
ASK = "ask the author for the file that rlbench submit wrote"
Reader = Callable[[Submission], CheckResult]


def check_content(submission: Submission) -> Iterator[CheckResult]:
    """The results of all checks that need the file alone, in order."""
    for check in (
        _check_hash,
        _check_clips,
        _check_complete,
        _check_budgets,
        _check_values,
        _check_limits,
        _check_finite,
        _check_ceiling,
        _check_identity,
        _check_times,
    ):
        yield check(submission)


def _check_hash(submission: Submission) -> CheckResult:
    if (found := content_hash(submission)) == submission.content_hash:
        return passed("content hash", f"{found[:12]}; it says unchanged, not by whom")
    return failed(
        "content hash", f"{found[:12]}, the file says {submission.content_hash[:12]}", ASK
    )


def _check_clips(submission: Submission) -> CheckResult:
    known = set(submission.clips_by_name)
    if len(known) < len(submission.clips):
        return failed("clips named", "two clips have one name", ASK)
    if strangers := sorted({cell.clip for cell in submission.cells} - known):
        return failed("clips named", f"cells of clips without facts: {_join(strangers)}", ASK)
    if empty := sorted(name for name, clip in submission.clips_by_name.items() if not clip.digests):
        return failed("clips named", f"no digest of {_join(empty)}", ASK)
    return passed("clips named", f"{len(known)} clips with digests")


def _check_complete(submission: Submission) -> CheckResult:
    """Was the same measured of each method, or were the best cells picked?"""
    cells = [(c.method, c.clip, c.target_spp, c.seed, c.device) for c in submission.cells]
    if len(set(cells)) < len(cells):
        return failed("complete", "one cell is there twice", ASK)
    if not submission.measured:
        return failed("complete", "no cell has a score", ASK)
    parts = [sorted({cell[i] for cell in cells}, key=str) for i in range(5)]
    gaps = [cell for cell in product(*parts) if cell not in set(cells)]
    if not gaps:
        return passed("complete", f"{len(cells)} cells: every method, clip, budget and seed")
    method, clip, spp, seed, _ = gaps[0]
    first = f"{method} on {clip} at {float(str(spp)):g} spp, seed {seed}"
    text = f"{len(gaps)} of {len(gaps) + len(cells)} cells are missing, such as {first}"
    return warning("complete", text, "compare methods on the cells that both have")


def _check_budgets(submission: Submission) -> CheckResult:
    """A budget is exact: round(spp x pixels) samples in every frame."""
    clips, wrong = submission.clips_by_name, []
    for cell in submission.measured:
        if (clip := clips.get(cell.clip)) is None:
            continue
        budget = round(cell.target_spp * clip.pixels)
        if cell.samples != (budget,) * clip.frames:
            other = [count for count in cell.samples if count != budget]
            found = f"{other[0]} samples" if other else f"{len(cell.samples)} frames"
            wrong.append(f"{cell}: {found}, expected {budget} in each of {clip.frames} frames")
    remedy = "measure with today's rlbench run, whose budgets are exact"
    return _judge("budgets", wrong, f"exact in {len(submission.measured)} cells", remedy)


def _check_values(submission: Submission) -> CheckResult:
    """Every frame has a PSNR, and what has no value has a note."""
    clips, wrong = submission.clips_by_name, []
    for cell in submission.measured:
        frames = clips[cell.clip].frames if cell.clip in clips else len(cell.samples)
        psnr = cell.scores.get("psnr", ())
        if len(psnr) != frames or None in psnr:
            wrong.append(f"{cell}: a PSNR of {len(psnr) - psnr.count(None)} of {frames} frames")
        bad = [n for n, values in cell.scores.items() if len(values) != frames]
        bad += [n for n, each in cell.values.items() if each.value is None and not each.note]
        wrong += [f"{cell}: {name} lacks values, and a note" for name in bad]
    return _judge("values", wrong, "every frame has its scores", ASK)


def _check_limits(submission: Submission) -> CheckResult:
    wrong = [
        f"{cell}: {name} is {value:g}, its range is {low:g} to {high:g}"
        for cell, name, value in _frame_scores(submission)
        for low, high in [LIMITS.get(name, (-math.inf, math.inf))]
        if not low - 1e-6 <= value <= high + 1e-6
    ]
    return _judge("ranges", wrong, "scores are in the ranges of their metrics", ASK)


def _check_finite(submission: Submission) -> CheckResult:
    clips, wrong, total = submission.clips_by_name, [], 0.0
    for cell in submission.measured:
        counts = cell.scores.get("nonfinite", ())
        pixels = clips[cell.clip].pixels if cell.clip in clips else math.inf
        for count in counts:
            if count is None or not 0 <= count <= pixels or count != int(count):
                wrong.append(f"{cell}: {count} pixels that are not finite")
            else:
                total += count
        if not counts:
            wrong.append(f"{cell}: no count of pixels that are not finite")
    if wrong or not total:
        return _judge("finite", wrong, "all images are finite", ASK)
    return warning("finite", f"{total:g} pixels are NaN or infinite", "see them as errors")


def _check_ceiling(submission: Submission) -> CheckResult:
    """No image is nearer to a noisy reference than the truth is, unless it has seen it."""
    wrong, seen = [], 0
    for cell, frame, psnr, ceiling in _with_ceiling(submission):
        seen += 1
        if psnr > ceiling + CEILING_TOLERANCE_DB:
            wrong.append(
                f"{cell}: PSNR {psnr:.2f} dB in frame {frame}, above the noise ceiling of the "
                f"reference, {ceiling:.2f} dB"
            )
    if not seen:
        return not_applicable("noise ceiling", "the clips do not state it")
    remedy = "find out how the method saw the reference, or the clip"
    return _judge("noise ceiling", wrong, f"{seen} frames are below it", remedy)


def _check_identity(submission: Submission) -> CheckResult:
    """Mean squared error = debiased error + noise of the reference, in expectation."""
    wrong, seen, largest = [], 0, 0.0
    for cell, frame, psnr, ceiling in _with_ceiling(submission):
        debiased = cell.scores.get("psnr_debiased", ())
        value = debiased[frame] if frame < len(debiased) else None
        if value is None or not -10 <= value <= 100:  # else it is out of range already
            continue
        seen += 1
        expected = -10 * math.log10(10 ** (-value / 10) + 10 ** (-ceiling / 10))
        largest = max(largest, abs(psnr - expected))
        if abs(psnr - expected) > IDENTITY_TOLERANCE_DB:
            wrong.append(
                f"{cell}: PSNR {psnr:.2f} dB in frame {frame}, but psnr_debiased and the noise of "
                f"the reference give {expected:.2f} dB"
            )
    if not seen:
        return not_applicable("psnr_debiased agrees", "no frame has both and a noise ceiling")
    found = f"with PSNR within {largest:.2f} dB in {seen} frames"
    return _judge("psnr_debiased agrees", wrong, found, ASK)


def _check_times(submission: Submission) -> CheckResult:
    wrong, seen = [], 0
    for cell, (name, parts) in product(submission.measured, SUMS.items()):
        known = [cell.values[part].value for part in (name, *parts) if part in cell.values]
        if len(known) < len(parts) + 1 or None in known:
            continue
        total, *terms = (value for value in known if value is not None)
        seen += 1
        if not math.isclose(total, sum(terms), rel_tol=TIME_TOLERANCE, abs_tol=1e-9):
            wrong.append(f"{cell}: {name} is {total:.4g}, its parts sum to {sum(terms):.4g}")
        if min(total, *terms) < 0:
            wrong.append(f"{cell}: {name} has a negative part")
    if not seen:
        return not_applicable("times", "none were measured")
    return _judge("times", wrong, f"the parts of {seen} times sum to them", ASK)


def _frame_scores(submission: Submission) -> Iterator[tuple[SubmittedCell, str, float]]:
    for cell in submission.measured:
        for name, values in cell.scores.items():
            yield from ((cell, name, value) for value in values if value is not None)


def _with_ceiling(submission: Submission) -> Iterator[tuple[SubmittedCell, int, float, float]]:
    """Cell, frame, PSNR and noise ceiling of each frame that has both."""
    for cell in submission.measured:
        clip = submission.clips_by_name.get(cell.clip)
        ceilings = clip.noise_ceiling_db if clip else ()
        pairs = zip(cell.scores.get("psnr", ()), ceilings, strict=False)
        for frame, (psnr, ceiling) in enumerate(pairs):
            if psnr is not None:
                yield cell, frame, psnr, ceiling


def _judge(check: str, wrong: list[str], found: str, remedy: str) -> CheckResult:
    """Passed with what was found, or failed with the first case and the number of others."""
    if not wrong:
        return passed(check, found)
    others = f", and {len(wrong) - 1} more" if len(wrong) > 1 else ""
    return failed(check, f"{wrong[0]}{others}", remedy)


def _join(names: Iterable[str]) -> str:
    return ", ".join(names)
