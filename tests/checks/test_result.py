"""A check result as text, and as a failing test."""

from __future__ import annotations

import pytest

from rlbench.checks.result import Verdict, failed, not_applicable, passed, warning


def test_each_constructor_has_its_verdict():
    results = passed("a"), warning("a", "b", "c"), failed("a", "b", "c"), not_applicable("a", "b")
    assert [result.verdict for result in results] == list(Verdict)


def test_a_failed_result_raises_with_its_text_and_its_cause():
    cause = ZeroDivisionError("division by zero")
    with pytest.raises(AssertionError, match="budget: found 3 -> draw 4") as raised:
        failed("budget", "found 3", "draw 4", cause).raise_if_failed()
    assert raised.value.__cause__ is cause


@pytest.mark.parametrize("result", [passed("a"), warning("a", "b", "c"), not_applicable("a", "b")])
def test_any_other_result_does_not_raise(result):
    result.raise_if_failed()


def test_text_leaves_out_what_is_empty():
    assert str(passed("depth")) == "depth"
    assert str(not_applicable("depth", "no buffer")) == "depth: no buffer"
