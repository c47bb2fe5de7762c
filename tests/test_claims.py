"""Every sentence of the README that compares methods follows from a generated table."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from reports.analysis.differences import LEADS, NOT_RESOLVED, TIE, TIE_DB, name_verdict
from reports.analysis.intervals import Interval

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results"
README = (ROOT / "README.md").read_text()
COMPARING = re.compile(
    r"\b(leads?|leading|ahead|behind|beats?|beaten|better|worse|best|worst|within|ties?|tied|gives"
    r"|trails?|resolved?|separate|wins?|winn(ers?|ing)|loses?|lost|outperforms?|exceeds?"
    r"|surpass\w*|superior|inferior|higher|lower|fewer|less|least|most|faster|slower|cheaper"
    r"|narrow|wide)\b",
    re.IGNORECASE,
)
NUMBER = re.compile(r"[+-]?\d+\.\d+")
DIFFERENCE = re.compile(r"[+-]\d+\.\d+ \[[+-]\d+\.\d+, [+-]\d+\.\d+\]")
PAGES_OF_DIFFERENCES = ("unseen.md", "ablation-unseen.md", "ablation-real.md")
# sentences that state the question or what a command prints, not a result
NO_RESULT = {
    "Given your renderer's cost",
    "Your cost of a sample can change the choice",
}


def read_rows(page: str, title: str) -> dict[str, dict[str, str]]:
    """The cells of the table under a heading, by row and column; without emphasis."""
    text = (RESULTS / page).read_text()
    section = text[text.index(f"### {title}\n") :].split("\n### ")[0]
    lines = [line.strip("|") for line in section.splitlines() if line.startswith("| ")]
    header, *rows = [[cell.strip(" *") for cell in line.split("|")] for line in lines]
    return {cells[0].partition(":")[0]: dict(zip(header, cells, strict=True)) for cells in rows}


def parse_gap(cell: str) -> Interval:
    """The difference and its interval in a cell such as `-0.18 [-0.27, -0.08]`."""
    mean, low, high = map(float, NUMBER.findall(cell)[:3])
    return Interval(mean, low, high, 2)


PSNR = "PSNR [dB], mean over scenes"
FIRST_PSNR = "PSNR of the first frame of each clip [dB], mean over scenes"
BUDGETS = ("1 spp", "2 spp", "4 spp")


def lead(page: str, other: str, spp: str = "1 spp", title: str = PSNR) -> float:
    """The mean score of `ours` minus that of another row, rounded as the README prints it."""
    rows = read_rows(page, title)
    ours, theirs = (float(NUMBER.findall(rows[name][spp])[0]) for name in ("ours", other))
    return round(round(ours - theirs, 2), 1)


def check_leads_on_real() -> None:
    leads = [lead("real.md", *words) for words in (("oidn",), ("oidn", "4 spp"), ("svgf",))]
    assert leads == [1.1, 0.7, 3.5]


def check_none_is_resolved_from_the_best() -> None:
    rows = read_rows("real.md", PSNR)
    cells = [
        rows[row][spp] for row in ("ours", "ours/by-rule", "accumulate/tuned") for spp in BUDGETS
    ]
    assert all("[" not in cell or cell.endswith(("tie", "not resolved")) for cell in cells)


def check_lead_at_640x360() -> None:
    leads = [lead(f"{preset}-640x360.md", "oidn") for preset in ("mini", "real")]
    assert leads == [1.1, 0.8]


def check_first_frame_at_640x360() -> None:
    assert lead("real-640x360.md", "oidn", title=FIRST_PSNR) == -0.6


def check_other_rules_tie() -> None:
    rows = read_rows("unseen.md", "PSNR [dB], minus ours")
    cells = [rows[row][spp] for row in ("ours/by-rule", "accumulate/tuned") for spp in BUDGETS]
    assert all(cell.endswith("] tie") for cell in cells)


def check_first_frame() -> None:
    cells = read_rows("unseen.md", "First frame")["oidn/tuned"]
    for spp in ("1 spp", "2 spp"):
        assert name_verdict(parse_gap(cells[spp]), "dB") == LEADS
        assert cells[spp].endswith("]")  # also after Holm's correction, which would mark it


CLAIMS: dict[str, Callable[[], None]] = {
    "`ours` leads `oidn` by 1.1 dB at 1 spp and 0.7 dB at 4 spp, and `svgf` by 3.5 dB at 1 spp": (
        check_leads_on_real
    ),
    "No difference between `ours`, `ours/by-rule`, `accumulate/tuned` and the best row": (
        check_none_is_resolved_from_the_best
    ),
    "at 640x360, `ours` leads `oidn` by 1.1 dB on `mini` and 0.8 dB on `real` at 1 spp": (
        check_lead_at_640x360
    ),
    "On first frames of `real` it is 0.6 dB behind": check_first_frame_at_640x360,
    "`accumulate/tuned` and `ours/by-rule` tie with `ours` at 1, 2 and 4 spp": (
        check_other_rules_tie
    ),
    "on a first frame it is behind `oidn/tuned` at 1 and 2 spp": check_first_frame,
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_a_claim_of_the_readme_follows_from_a_table(claim: str) -> None:
    assert claim in " ".join(README.split())
    CLAIMS[claim]()


def test_every_comparing_sentence_of_the_readme_is_a_checked_claim() -> None:
    prose = re.sub(r"```.*?```|<!-- table.*?/table -->", "", README, flags=re.S)
    sentences = re.split(r"(?<=[.!?])\s+(?=[A-Z*`\[!])", " ".join(prose.split()))
    compared = [sentence for sentence in sentences if COMPARING.search(sentence)]
    known = [*CLAIMS, *NO_RESULT]
    unknown = [s for s in compared if not any(claim in s for claim in known)]
    assert len(compared) >= 2
    assert unknown == []


@pytest.mark.parametrize("page", PAGES_OF_DIFFERENCES)
def test_the_verdict_of_a_generated_cell_follows_from_its_printed_interval(page: str) -> None:
    lines = [x for x in (RESULTS / page).read_text().splitlines() if x.startswith("| ")]
    cells = [cell.strip() for line in lines for cell in line.split("|") if DIFFERENCE.search(cell)]
    assert len(cells) >= 20
    for cell in cells:
        gap = parse_gap(cell)
        if {abs(gap.low), abs(gap.high)} & {0.0, TIE_DB}:
            continue  # rounded to a bound: the figures with all digits decide
        words = next((word for word in (TIE, NOT_RESOLVED) if cell.endswith(word)), "")
        verdict = name_verdict(gap, "dB")
        assert words == (verdict if verdict in (TIE, NOT_RESOLVED) else ""), cell
        assert cell.startswith("**") == (words == ""), cell
