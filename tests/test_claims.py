"""Every sentence of the README that compares methods follows from a generated table."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results"
README = (ROOT / "README.md").read_text()
COMPARING = re.compile(r"\b(leads?|ahead|behind|beats?|better|worse|best|within|ties?|gives)\b")
# sentences that state the question or what a command prints, not a result
NO_RESULT = {"Given your renderer's cost", "`rlbench stress` gives verdicts"}


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


LEARNED_DENSITIES = {
    *(f"ours{variant}" for variant in ("", "/lean", "/small", "/A1", "/C", "/lag", "/stateless")),
    *("ours/B1", "ours/B2", "ours/paper", "ntas", "ntas/direct", "ntas/history", "dasr"),
    *("dasr/gamma",),
}


def check_contrast_from_one_spp() -> None:
    for spp in ("1", "2", "4"):
        assert abs(read_differences("controls.md", spp)["accumulate/contrast"]) <= 0.02


def check_contrast_below_one_spp() -> None:
    header, *_, last = read_rows("controls.md", "PSNR [dB] at 0.5 spp")
    cell = last[header.index("accumulate/contrast")]
    low, high = map(float, re.findall(r"\[(\S+), (\S+)\]", cell)[0])
    assert low < high < 0


def check_no_learned_density_wins() -> None:
    rows = csv.DictReader((RESULTS / "winners.csv").read_text().splitlines())
    winners = {row["method"] for row in rows}
    assert winners >= {"accumulate/contrast", "ours/by-rule"}
    assert not winners & LEARNED_DENSITIES


CLAIMS: dict[str, Callable[[], None]] = {
    "(`accumulate/contrast`) are within 0.02 dB of `ours` at 1, 2 and 4 spp": (
        check_contrast_from_one_spp
    ),
    "below, `ours` leads": check_contrast_below_one_spp,
    "no row with a learned density is best at any deadline or cost of a sample": (
        check_no_learned_density_wins
    ),
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
