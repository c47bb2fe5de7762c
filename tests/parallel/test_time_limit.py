"""A time limit ends a command between two jobs, and loses none that is done."""

from __future__ import annotations

import math

import pytest

from rlbench.parallel.executor import LOCAL, OutOfTimeError, TimeLimit, TimeLimitedExecutor


def double(job, on_progress):
    return 2 * job


@pytest.mark.parametrize(("limit", "jobs"), [(TimeLimit(), [1, 2, 3]), (TimeLimit(1e-9), [1])])
def test_without_a_limit_or_before_its_end_every_job_is_done(limit, jobs):
    results = TimeLimitedExecutor(limit).map(double, jobs)
    assert [result.value for result in results] == [2 * job for job in jobs]
    assert TimeLimit().minutes_left == math.inf


def test_after_the_limit_no_job_begins_and_done_ones_are_kept():
    results = TimeLimitedExecutor(TimeLimit(1e-9)).map(double, [1, 2, 3])
    assert next(results).value == 2
    with pytest.raises(OutOfTimeError, match="1e-09 minutes are over, and 2 of 3 jobs are not"):
        next(results)


def test_the_rest_is_that_of_the_executor():
    limited = TimeLimitedExecutor(TimeLimit(3), LOCAL)
    assert (limited.exclusive, limited.description) == (LOCAL.exclusive, LOCAL.description)
    assert limited.local_exclusive() == limited
    assert 2.9 < limited.limit.minutes_left < 3
