"""Every sentence of the README that compares methods follows from a generated table."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results"
README = (ROOT / "README.md").read_text()
COMPARING = re.compile(r"\b(leads?|ahead|behind|beats?|better|worse|best|within|ties?|gives)\b")
NO_RESULT = {"Given your renderer's cost"}  # a sentence that states the question, not a result


def read_rows(page: str, title: str) -> list[list[str]]:
    """The cells of the table under a heading, its header first; without emphasis."""
    text = (RESULTS / page).read_text()
    section = text[text.index(f"### {title}\n") :].split("\n### ")[0]
    lines = [line for line in section.splitlines() if line.startswith("| ")]
    return [[cell.strip(" *") for cell in line.strip("|").split("|")] for line in lines]


def read_differences(page: str, spp: str) -> dict[str, float]:
    """The mean difference to `ours` of each row in dB, from the last line of a table by clip."""
    header, *_, last = read_rows(page, f"PSNR [dB] at {spp} spp")
    assert last[0] == "minus ours"
    cells = zip(header[1:], last[1:], strict=True)
    return {name: float(cell.split()[0]) for name, cell in cells if cell != "-"}


def read_curve(method: str) -> tuple[np.ndarray, np.ndarray]:
    """Frame times in ms and PSNR in dB of a method at all its budgets, preset `mini`."""
    header, *rows = read_rows("summary.md", "psnr [dB], mean over scenes")
    scores = dict(zip(header[1:], next(r for r in rows if r[0] == method)[1:], strict=True))
    _, *times = read_rows("summary.md", "time of a frame [ms], mean over scenes")
    pairs = [
        (float(row[-1]), float(scores[f"{row[1]} spp"].split()[0]))
        for row in times
        if row[0] == method
    ]
    ms, psnr = np.array(sorted(pairs)).T
    return ms, psnr


def check_contrast_from_one_spp() -> None:
    for spp in ("1", "2", "4"):
        assert abs(read_differences("controls.md", spp)["accumulate/contrast"]) <= 0.02


def check_contrast_below_one_spp() -> None:
    header, *_, last = read_rows("controls.md", "PSNR [dB] at 0.5 spp")
    cell = last[header.index("accumulate/contrast")]
    low, high = map(float, re.findall(r"\[(\S+), (\S+)\]", cell)[0])
    assert low < high < 0


def check_break_even_time() -> None:
    ours, tuned = read_curve("ours"), read_curve("oidn/tuned")
    times = np.linspace(ours[0].min(), min(ours[0].max(), tuned[0].max()), 1000)
    is_ahead = np.interp(times, *ours) > np.interp(times, *tuned)
    (changes,) = np.nonzero(np.diff(is_ahead))
    assert len(changes) == 1
    assert times[changes[0]] == pytest.approx(120, rel=0.05)
    assert is_ahead[-1]


CLAIMS: dict[str, Callable[[], None]] = {
    "(`accumulate/contrast`) are within 0.02 dB of `ours` at 1, 2 and 4 spp": (
        check_contrast_from_one_spp
    ),
    "below, `ours` leads": check_contrast_below_one_spp,
    "`oidn/tuned` is ahead below about 120 ms a frame": check_break_even_time,
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_a_claim_of_the_readme_follows_from_a_table(claim: str) -> None:
    assert claim in " ".join(README.split())
    CLAIMS[claim]()


def test_every_comparing_sentence_of_the_readme_is_a_checked_claim() -> None:
    prose = re.sub(r"```.*?```|<!-- results -->.*?<!-- /results -->", "", README, flags=re.S)
    sentences = re.split(r"(?<=[.!?])\s+(?=[A-Z*`\[!])", " ".join(prose.split()))
    compared = [sentence for sentence in sentences if COMPARING.search(sentence)]
    known = [*CLAIMS, *NO_RESULT]
    unknown = [s for s in compared if not any(claim in s for claim in known)]
    assert len(compared) >= 2
    assert unknown == []
