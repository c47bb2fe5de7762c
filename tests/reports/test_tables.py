"""Tables as Markdown and LaTeX: special characters are escaped."""

from __future__ import annotations

from reports.layout.tables import Bold, Table, to_latex, to_markdown


def test_latex_escapes_its_special_characters():
    table = Table("50 % of a_b", "x & y", ("m", "v"), (("a_b", Bold("1")),))
    text = to_latex(table)
    assert r"\caption{50 \% of a\_b. x \& y}" in text
    assert r"a\_b & \textbf{1} \\" in text


def test_markdown_escapes_the_bar_between_columns():
    assert "| a\\|b | **1** |" in to_markdown(Table("t", "c", ("m", "v"), (("a|b", Bold("1")),)))
