"""Each kind of tampering is found by its own check, also where the hash was computed anew."""

from __future__ import annotations

import shutil
from dataclasses import replace

import pytest

from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.submission import machine_checks
from rlbench.benchmark.submission.content_checks import check_content
from rlbench.benchmark.submission.document import content_hash
from rlbench.benchmark.submission.machine_checks import check_against_machine
from rlbench.checks.result import Verdict


def change_cell(submission, **changes):
    """The submission with another first cell that has scores, and the hash that it then has."""
    index = next(i for i, cell in enumerate(submission.cells) if not cell.skipped)
    cells = list(submission.cells)
    cells[index] = replace(cells[index], **changes)
    return rehash(submission, cells=tuple(cells))


def change_score(submission, metric, value):
    """The same with another value of a metric in frame 1."""
    scores = dict(next(cell for cell in submission.cells if not cell.skipped).scores)
    scores[metric] = (scores[metric][0], value, *scores[metric][2:])
    return change_cell(submission, scores=scores)


def rehash(submission, **changes):
    changed = replace(submission, **changes)
    return replace(changed, content_hash=content_hash(changed))


def findings(results):
    """What was found by each check that did not pass, by name."""
    return {r.check: r.found for r in results if r.verdict in (Verdict.FAILED, Verdict.WARNING)}


def test_an_honest_submission_passes_every_check(submitted):
    results = [
        *check_content(submitted.submission),
        *check_against_machine(submitted.submission, submitted.clips),
    ]
    assert {result.verdict for result in results} == {Verdict.PASSED}
    assert len(results) == 14


def test_a_changed_number_changes_the_hash(submitted):
    changed = replace(change_score(submitted.submission, "ssim", 0.5), content_hash="0" * 64)
    assert list(findings(check_content(changed))) == ["content hash"]


@pytest.mark.parametrize(
    ("metric", "value", "check", "found"),
    [
        ("psnr", 60.0, "noise ceiling", "above the noise ceiling of the reference, 55.00 dB"),
        ("psnr", 20.0, "psnr_debiased agrees", "but psnr_debiased and the noise of the reference"),
        ("psnr", None, "values", "a PSNR of 2 of 3 frames"),
        ("psnr", 101.0, "ranges", "psnr is 101, its range is 0 to 100"),
        ("psnr", -1e300, "ranges", "psnr is -1e+300"),
        ("psnr_debiased", -1e300, "ranges", "psnr_debiased is -1e+300"),
        ("ssim", 1.5, "ranges", "ssim is 1.5, its range is -1 to 1"),
        ("nonfinite", 481.0, "finite", "481.0 pixels that are not finite"),
        ("nonfinite", 0.5, "finite", "0.5 pixels that are not finite"),
        ("nonfinite", 7.0, "finite", "7 pixels are NaN or infinite"),
    ],
)
def test_a_score_that_cannot_be_is_found(submitted, metric, value, check, found):
    changed = change_score(submitted.submission, metric, value)
    problems = findings(check_content(changed))
    assert found in problems[check]
    assert "content hash" not in problems


@pytest.mark.parametrize(
    ("samples", "found"),
    [((240, 241, 240), "241 samples, expected 240"), ((240, 240), "2 frames, expected 240")],
)
def test_a_budget_that_is_not_exact_is_found(submitted, samples, found):
    problems = findings(check_content(change_cell(submitted.submission, samples=samples)))
    assert list(problems) == ["budgets"]
    assert found in problems["budgets"]


def test_a_time_that_is_not_the_sum_of_its_parts_is_found(submitted):
    cell = submitted.submission.measured[0]
    values = dict(cell.values)
    values["frame_ms"] = replace(values["frame_ms"], value=values["frame_ms"].value / 2)
    problems = findings(check_content(change_cell(submitted.submission, values=values)))
    assert list(problems) == ["times"]
    assert "frame_ms is" in problems["times"]


def test_a_cell_that_was_left_out_is_found(submitted):
    picked = rehash(submitted.submission, cells=submitted.submission.cells[1:])
    problems = findings(check_content(picked))
    assert problems == {
        "complete": "1 of 8 cells are missing, such as mean on attic at 0.5 spp, seed 0"
    }


def test_a_cell_that_is_there_twice_is_found(submitted):
    cells = submitted.submission.cells
    assert "complete" in findings(check_content(rehash(submitted.submission, cells=cells * 2)))


def test_a_clip_without_facts_or_digest_is_found(submitted):
    changed = rehash(submitted.submission, clips=submitted.submission.clips[1:])
    assert findings(check_content(changed))["clips named"] == "cells of clips without facts: attic"
    bare = tuple(replace(clip, digests={}) for clip in submitted.submission.clips)
    assert "clips named" in findings(check_content(rehash(submitted.submission, clips=bare)))


def with_digest(submission, **changes):
    first, *others = submission.clips
    changed = replace(first, digests={"path": "0" * 32}, **changes)
    return rehash(submission, clips=(changed, *others))


def test_other_pixels_by_the_same_tracer_and_processor_fail(submitted):
    changed = with_digest(submitted.submission)
    results = {r.check: r for r in check_against_machine(changed, submitted.clips)}
    assert results["clip digests"].verdict is Verdict.FAILED
    assert "attic has other pixels here" in results["clip digests"].found


def test_other_pixels_of_another_processor_are_a_warning(submitted):
    changed = with_digest(submitted.submission, device="another machine")
    results = {r.check: r for r in check_against_machine(changed, submitted.clips)}
    assert results["clip digests"].verdict is Verdict.WARNING


def test_clips_that_are_not_here_are_compared_with_the_shipped_list(submitted, monkeypatch):
    assert set(machine_checks.shipped_digests("mini")) == {"city", "temple", "hall", "ripples"}
    listed = {clip.name: clip.digests["path"][:12] for clip in submitted.submission.clips}
    monkeypatch.setattr(machine_checks, "shipped_digests", lambda preset: listed)
    first, *_ = check_against_machine(submitted.submission, {})
    assert first.verdict is Verdict.PASSED
    first, *_ = check_against_machine(with_digest(submitted.submission), {})
    assert first.verdict is Verdict.WARNING


def test_a_pool_that_the_clip_here_lacks_is_no_equal_clip(submitted, tmp_path):
    folder = shutil.copytree(submitted.clips["attic"].folder, tmp_path / "attic")
    first = submitted.submission.clips[0]
    digests = {**first.digests, "restir": "1" * 32}
    changed = rehash(
        submitted.submission,
        clips=(replace(first, digests=digests), *submitted.submission.clips[1:]),
    )
    clips = {**submitted.clips, "attic": StoredSource(folder)}
    result, *_ = check_against_machine(changed, clips)
    assert result.verdict is Verdict.WARNING


@pytest.mark.parametrize("what", ["code", "weights"])
def test_other_code_and_other_weights_are_a_warning(submitted, what):
    changed = change_cell(submitted.submission, **{f"{what}_hash": "0" * 16})
    problems = findings(check_against_machine(changed, submitted.clips))
    assert list(problems) == [what]
    assert "mean differ from those of rlbench" in problems[what]


def test_another_convention_of_a_metric_fails(submitted):
    metrics = tuple(
        replace(metric, convention="peak 255") if metric.name == "psnr" else metric
        for metric in submitted.submission.metrics
    )
    changed = rehash(submitted.submission, metrics=metrics)
    problems = findings(check_against_machine(changed, submitted.clips))
    assert problems == {"metrics": "psnr have another convention here"}


def test_a_method_that_is_not_installed_is_skipped(submitted):
    cells = tuple(replace(cell, method="stranger") for cell in submitted.submission.cells[:4])
    changed = rehash(submitted.submission, cells=cells)
    verdicts = {r.check: r.verdict for r in check_against_machine(changed, submitted.clips)}
    assert verdicts["code"] is verdicts["weights"] is Verdict.SKIPPED
