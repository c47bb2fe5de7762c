"""Tables as LaTeX: aligned at the decimal point, and split where they would leave the page.

Numbers stand in S columns of siunitx (version 3), with rules of booktabs; what follows a number,
such as its interval, stands in a column of its own.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from reports.layout.tables import Bold, Table

PREAMBLE = (
    "% \\usepackage{booktabs, textcomp}\n% \\usepackage{siunitx} % version 3\n"
    "% \\sisetup{detect-weight, mode = text}\n"
)
MAX_WIDTH, MAX_ROWS = 76, 44  # letters of \small, and rows, on a page of text
SUFFIX_SIZE = 0.75  # width of a letter of \scriptsize
NUMBER = re.compile(r"([+-]?)(\d+)(?:\.(\d+))?(.*)")
ESCAPES = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "†": r"\textdagger{}",
    ">": r"\textgreater{}",
    "<": r"\textless{}",
}
NOTHING = ("", "-")


def to_latex(table: Table, with_note: bool = True) -> str:
    """The table as LaTeX floats, one for each part that fits a page; `with_note`: with its note."""
    columns = list(zip(*[table.header, *table.rows], strict=True))
    numbers = [_Column(column[0], column[1:], table.beside) for column in columns[1:]]
    first = max((len(cell) for cell in columns[0]), default=0)
    parts = [
        (group, slice(start, start + MAX_ROWS))
        for group in _split(numbers, MAX_WIDTH - first)
        for start in range(0, max(len(table.rows), 1), MAX_ROWS)
    ]
    names = [row[0] for row in table.rows]
    captions = [f"{table.title}.", *[f"{table.title}, continued."] * (len(parts) - 1)]
    below = " ".join(filter(None, [table.caption, table.note * with_note]))
    return "\n".join(
        _float(text, below * (i == 0), table.header[0], names[rows], group, rows)
        for i, (text, (group, rows)) in enumerate(zip(captions, parts, strict=True))
    )


class _Column:
    """A column of cells: numbers and what follows them, or text."""

    def __init__(self, title: str, cells: Sequence[str], beside: str) -> None:
        self.title, self.cells, self.beside = title, cells, beside
        found = [NUMBER.fullmatch(cell) for cell in cells if cell not in NOTHING]
        self.is_text = not found or None in found
        matches = [match for match in found if match]
        self.has_suffix = not self.is_text and any(match[4] for match in matches)
        signs = any(match[1] for match in matches)
        digits, decimals = (max((len(m[i] or "") for m in matches), default=0) for i in (2, 3))
        self.format = f"{'+' * signs}{digits}.{decimals}"
        longest = max((len(cell) for cell in cells), default=0)
        suffix = max((len(match[4]) for match in matches), default=0)
        width = longest if self.is_text else signs + digits + decimals + 1 + SUFFIX_SIZE * suffix
        heading = len(title) + SUFFIX_SIZE * len(beside) * self.has_suffix
        self.width = max(width, heading) + 2

    @property
    def specification(self) -> str:
        """Of the column, for tabular."""
        if self.is_text:
            return "l"
        column = f"S[table-format={self.format}]"
        return column + "@{\\,}l" * self.has_suffix

    @property
    def heading(self) -> str:
        text = escape(self.title)
        if self.has_suffix and self.beside:
            return rf"{{{text}}} & {{\scriptsize {escape(self.beside)}}}"
        if self.has_suffix:
            return rf"\multicolumn{{2}}{{c}}{{{text}}}"
        return text if self.is_text else f"{{{text}}}"

    def cell(self, row: int) -> str:
        text = self.cells[row]
        bold = r"\bfseries " * isinstance(text, Bold)
        if self.is_text:
            return bold + escape(text)
        if text in NOTHING:
            return "{--}" * bool(text) + " & " * self.has_suffix
        match = NUMBER.fullmatch(text)
        assert match
        end = match.start(4)
        suffix = rf" & {{\scriptsize {escape(text[end:].strip())}}}"
        return f"{bold}{text[:end]}" + suffix * self.has_suffix


def _split(columns: Sequence[_Column], width: float) -> list[list[_Column]]:
    """The columns in groups that are at most as wide; a column that is wider is alone."""
    groups: list[list[_Column]] = [[]]
    for column in columns:
        if groups[-1] and sum(each.width for each in groups[-1]) + column.width > width:
            groups.append([])
        groups[-1].append(column)
    return groups


def _float(
    caption: str,
    below: str,
    title: str,
    names: Sequence[str],
    columns: Sequence[_Column],
    rows: slice,
) -> str:
    """A table with a caption of one sentence, and below it how to read it."""
    lines = [
        [escape(name), *(column.cell(rows.start + i) for column in columns)]
        for i, name in enumerate(names)
    ]
    heading = [escape(title), *(column.heading for column in columns)]
    specification = "l" + "".join(column.specification for column in columns)
    return "\n".join(
        [
            r"\begin{table}",
            r"\centering\small",
            rf"\caption{{{escape(caption)}}}",
            rf"\begin{{tabular}}{{{specification}}}",
            r"\toprule",
            " & ".join(heading) + r" \\",
            r"\midrule",
            *(" & ".join(line) + r" \\" for line in lines),
            r"\bottomrule",
            r"\end{tabular}",
            *(
                [rf"\par\smallskip\parbox{{\textwidth}}{{\footnotesize {escape(below)}}}"]
                * bool(below)
            ),
            r"\end{table}",
            "",
        ]
    )


def escape(text: str) -> str:
    """Text that LaTeX prints as it is, on one line; characters that do not print are left out."""
    printed = (c for c in " ".join(text.split()) if c.isprintable())
    return "".join(ESCAPES.get(c, c) for c in printed).replace("+-", r"$\pm$")
