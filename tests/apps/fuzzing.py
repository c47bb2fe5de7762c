"""Random changes of files, and the properties that hold on all of them.

Whatever a file holds: the right content, or one error that a user can act on. Each property runs
on some changed files, and on 2,000 in `make test-all`.
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rlbench.errors import RlbenchError

QUICK, THOROUGH = 200, 2000  # changed records of each kind
COUNTS = [60, pytest.param(THOROUGH, marks=pytest.mark.slow)]  # of files that take longer
Strategy = st.SearchStrategy[Any]
Property = Callable[[Any], object]


def fuzz(count: int, strategy: Strategy, property_: Property) -> None:
    """Check a property on so many examples; none may take longer than two seconds."""
    checks = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.function_scoped_fixture]
    limits = settings(
        max_examples=count,
        deadline=2000,
        derandomize=count < THOROUGH,
        suppress_health_check=checks,
    )
    limits(given(strategy)(property_))()


def fuzz_in_a_process(count: int, strategy: Strategy, property_: Property) -> None:
    """As `fuzz`, in a child, because the OpenEXR library may end it."""
    errors, child_errors = os.pipe()
    if (child := os.fork()) == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # OpenEXR writes its errors there
        try:
            fuzz(count, strategy, property_)
        except BaseException as error:
            os.write(child_errors, repr(error).encode()[:4000])
        finally:
            os._exit(0)
    os.close(child_errors)
    with os.fdopen(errors, "rb") as pipe:
        assert (error := pipe.read()) == b"", error.decode()
    assert os.waitpid(child, 0)[1] == 0


def examples(property_: Property, strategy: Strategy) -> Any:
    """A test of a property on many examples, and one on ten times as many for `make test-all`."""

    def check(count: int) -> None:
        fuzz(count, strategy, property_)

    counts = [QUICK, pytest.param(THOROUGH, marks=pytest.mark.slow)]
    return pytest.mark.parametrize("count", counts)(check)


def result_or_error(function: Callable[..., Any], *arguments: object) -> Any:
    """What a function returns, or its RlbenchError; any other exception fails the test."""
    try:
        return function(*arguments)
    except RlbenchError as error:
        return error


@st.composite
def draw_change(draw: st.DrawFn, content: bytes) -> bytes:
    """A content with flipped bits, replaced, inserted, removed or repeated parts, or cut short."""
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, max(len(content) - 1, 0)))
        end = min(start + draw(st.sampled_from([0, 1, 2, 8, 64])), len(content))
        new = {
            "flip": bytes([content[start] ^ 1 << draw(st.integers(0, 7))]) if content else b"",
            "replace": draw(st.binary(max_size=16)),
            "repeat": content[start:end] * 3,
            "cut": b"",
        }[how := draw(st.sampled_from(["flip", "replace", "repeat", "cut"]))]
        tail = {"flip": content[start + 1 :], "cut": b""}.get(how, content[end:])
        content = content[:start] + new + tail
    return content


NUMBERS = st.one_of(st.integers(), st.floats(), st.sampled_from([-(2**63), 2**63, 10**40, 1e308]))
DATES = st.sampled_from([datetime.date(2026, 1, 2), datetime.time(3, 4), datetime.datetime.max])
LEAVES = st.one_of(NUMBERS, st.booleans(), st.text(max_size=8))
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
    max_leaves=6,
)
NESTED = st.integers(1, 3000).map(lambda depth: f"{'[' * depth}{']' * depth}")


@st.composite
def with_other_values(draw: st.DrawFn, document: dict[str, Any], values: Any) -> dict[str, Any]:
    """A document with other, missing and unknown values."""
    document = dict(document)
    for name in draw(st.lists(st.sampled_from(sorted(document)), min_size=1, max_size=3)):
        document[name] = draw(values)
    for name in draw(st.lists(st.sampled_from(sorted(document)), max_size=1)):
        del document[name]
    return document | draw(st.dictionaries(st.text(max_size=3), values, max_size=1))
